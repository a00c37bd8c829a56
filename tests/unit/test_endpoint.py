"""The bus is closed unless the site opens it: which endpoints are taken, and whose folder is trusted."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from rodeo.bus.session import Bus
from rodeo.errors import ConfigError, UnsafeSocketFolder
from rodeo.site import endpoint
from rodeo.site.config import Site
from rodeo.site.tls import bus_is_closed, openness, wants_certificates
from tests.support.site import LAB


def site_with(folder: Path, *lines: str) -> Site:
    path = folder / "site.toml"
    path.write_text("\n".join([f'extends = "{LAB}"', 'data_dir = "data"', *lines]))
    return Site.load(path)


def folder_of(site: Site) -> Path:
    return Path(site.bus.router.removeprefix("unixsock-stream/")).parent


def test_by_default_the_router_is_a_socket_in_a_folder_of_the_sites_own(tmp_path: Path) -> None:
    site = site_with(tmp_path)
    assert site.bus.router == f"unixsock-stream/{tmp_path}/data/bus/router.sock"
    assert bus_is_closed(site) and not wants_certificates(site) and openness(site) == ""


def test_two_sites_have_two_sockets_and_one_site_has_one(tmp_path: Path) -> None:
    for depth in ("a", "b" * 150):
        (tmp_path / depth).mkdir()
    routers = [site_with(tmp_path / depth).bus.router for depth in ("a", "b" * 150) for _ in range(2)]
    assert routers[0] == routers[1] != routers[2] == routers[3]


def test_a_data_directory_of_any_length_gets_a_socket_that_the_kernel_takes(tmp_path: Path) -> None:
    deep = tmp_path / ("ä" * 60) / ("b" * 30)
    deep.mkdir(parents=True)
    path = site_with(deep).bus.router.removeprefix("unixsock-stream/")
    assert len(os.fsencode(path)) <= 107
    assert str(os.geteuid()) in path, "two users of one path do not meet in it"


@pytest.mark.parametrize("name", ["#1", "what?"])
def test_a_data_directory_whose_name_means_options_to_zenoh_gets_another_socket(
    tmp_path: Path, name: str
) -> None:
    (tmp_path / name).mkdir()
    router = site_with(tmp_path / name).bus.router
    assert endpoint.is_local(router) and endpoint.problem(router, False) == ""


@pytest.mark.parametrize(
    "router",
    [
        "tcp/127.0.0.1:7447",
        "tcp/localhost:7447",
        "tcp/192.168.1.10:7447",
        "tcp/[::]:7447",
        "udp/127.0.0.1:7447",
        "quic/192.168.1.10:7447",
        "ws/127.0.0.1:7447",
        "TLS/192.168.1.10:7447",
        "",
    ],
)
def test_an_endpoint_that_anybody_can_reach_is_refused_unless_it_is_chosen(
    tmp_path: Path, router: str
) -> None:
    with pytest.raises(ConfigError) as caught:
        site_with(tmp_path, f'bus.router = "{router}"')
    said = caught.value.details["fields"]["bus"]
    assert "tls/" in said and "bus.open = true" in said and router in said
    site = site_with(tmp_path, f'bus.router = "{router}"', "bus.open = true")
    assert not bus_is_closed(site)
    assert "the bus is open" in openness(site) and router in openness(site)


def test_the_environment_cannot_open_the_bus_unnamed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RODEO__BUS__ROUTER", "tcp/127.0.0.1:7447")
    with pytest.raises(ConfigError, match=r"bus\.open"):
        site_with(tmp_path)
    monkeypatch.setenv("RODEO__BUS__OPEN", "true")
    assert not bus_is_closed(site_with(tmp_path))


@pytest.mark.parametrize(
    "router",
    [
        "tls/192.168.1.10:7447#enable_mtls=false",
        "tls/192.168.1.10:7447?prio=1-7",
        "unixsock-stream/relative/router.sock",
        "unixsock-stream//" + "x" * 120,
    ],
)
def test_an_endpoint_that_only_seems_closed_is_refused(tmp_path: Path, router: str) -> None:
    with pytest.raises(ConfigError) as caught:
        site_with(tmp_path, f'bus.router = "{router}"')
    assert "bus" in caught.value.details["fields"]


def test_another_machine_is_reached_with_certificates(tmp_path: Path) -> None:
    site = site_with(tmp_path, 'bus.router = "tls/192.168.1.10:7447"')
    assert wants_certificates(site) and bus_is_closed(site)


def test_the_folder_of_the_socket_is_its_owners_alone_whatever_the_umask(tmp_path: Path) -> None:
    site = site_with(tmp_path)
    before = os.umask(0)
    try:
        endpoint.make_socket_folder(site.bus.router)
    finally:
        os.umask(before)
    assert folder_of(site).stat().st_mode & 0o7777 == 0o700
    endpoint.make_socket_folder(site.bus.router)  # as after a restart


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701, 0o1777])
def test_a_folder_that_others_can_enter_is_refused_by_router_and_clients(tmp_path: Path, mode: int) -> None:
    site = site_with(tmp_path)
    endpoint.make_socket_folder(site.bus.router)
    folder_of(site).chmod(mode)
    for use in (endpoint.make_socket_folder, lambda router: Bus.open(router, timeout_s=0.0)):
        with pytest.raises(UnsafeSocketFolder) as caught:
            use(site.bus.router)
        assert caught.value.details["path"] == str(folder_of(site))
        assert caught.value.details["mode"] == f"{mode:04o}"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_another_user_is_refused(tmp_path: Path) -> None:
    site = site_with(tmp_path)
    endpoint.make_socket_folder(site.bus.router)
    os.chown(folder_of(site), 65534, 65534)
    for use in (endpoint.make_socket_folder, lambda router: Bus.open(router, timeout_s=0.0)):
        with pytest.raises(UnsafeSocketFolder) as caught:
            use(site.bus.router)
        assert (caught.value.details["owner"], caught.value.details["expected"]) == (65534, 0)


def test_a_link_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    site = site_with(tmp_path)
    (tmp_path / "private").mkdir(mode=0o700)
    folder_of(site).parent.mkdir()
    folder_of(site).symlink_to(tmp_path / "private")
    with pytest.raises(UnsafeSocketFolder):
        endpoint.make_socket_folder(site.bus.router)

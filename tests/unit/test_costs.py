"""What a process costs while it has nothing to do."""

from __future__ import annotations

import subprocess
import sys
import threading
from pathlib import Path

import pytest
import zenoh

from rodeo.bus.session import Bus, zenoh_config
from rodeo.lab.render import Camera
from rodeo_testing.waiting import wait_until
from tests.support.nodes import router_port as router_port

# isort: split
import mujoco  # after the lab, which chooses its OpenGL back end

MORE_BYTES = 20_000
"""Zenoh puts a message of this size into shared memory where it may."""


def _shared() -> set[str]:
    """Zenoh's pools of shared memory that this process maps; others' tests may have left some."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    return {line.split(maxsplit=5)[5] for line in lines if ".zenoh" in line}


def test_large_messages_map_no_shared_memory(router_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{router_port}"
    heard, before = threading.Event(), _shared()

    def put_and_look() -> bool:
        ours.put_bytes("picture", bytes(MORE_BYTES))
        return heard.is_set()

    with Bus.open(endpoint) as ours, Bus(zenoh.open(zenoh_config("client", connect=[endpoint]))) as theirs:
        theirs.subscribe_bytes("picture", lambda _key, payload: len(payload) == MORE_BYTES and heard.set())
        wait_until(put_and_look)
        assert _shared() <= before


def test_a_process_has_two_arenas_however_many_threads_allocate() -> None:
    program = """
import ctypes, sys, threading
from rodeo.runtime.process import supervise
libc = ctypes.CDLL(None)
def body(stop):
    allocated = threading.Barrier(12)
    def work():
        libc.malloc(ctypes.c_size_t(1000))
        allocated.wait()
    threads = [threading.Thread(target=work) for _ in range(allocated.parties)]
    for one in threads: one.start()
    for one in threads: one.join()
    libc.fdopen.restype = ctypes.c_void_p
    out = ctypes.c_void_p(libc.fdopen(1, b"w"))
    libc.malloc_info(0, out)
    libc.fflush(out)
sys.exit(supervise("test", body))
"""
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    assert 1 <= told.count("<heap nr=") <= 2


def test_a_camera_has_buffers_of_its_pictures_size_and_leaves_the_model_as_it_was(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    model = mujoco.MjSpec().compile()
    size = model.vis.global_
    models_px = size.offwidth, size.offheight
    made_px = []
    monkeypatch.setattr(
        mujoco, "Renderer", lambda *_arguments: made_px.append((size.offwidth, size.offheight))
    )
    Camera(model, "bin/camera", 320, 240)
    assert made_px == [(320, 240)]
    assert (size.offwidth, size.offheight) == models_px

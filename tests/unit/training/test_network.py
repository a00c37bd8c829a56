"""The network that is trained and the file that is run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnxruntime
import pytest

torch = pytest.importorskip("torch", reason="needs pip install -r training/requirements.txt")

import onnx  # noqa: E402

from rodeo.vision.classification import MODEL_DIR, PREPROCESSING, WEIGHTS, BrokenModel  # noqa: E402
from rodeo.vision.classifier import Classifier  # noqa: E402
from training.compact import compact  # noqa: E402
from training.network import Network, export, exported  # noqa: E402
from training.second import Second  # noqa: E402

SIDE_PX = 64


@pytest.fixture
def network() -> Network:
    torch.manual_seed(0)
    return Network(outputs=7, drop_connect=0.1).eval()


def test_the_exported_file_answers_as_the_network_does(network: Network, tmp_path: Path) -> None:
    picture = np.random.default_rng(0).uniform(-1, 1, (1, 3, SIDE_PX, SIDE_PX)).astype(np.float32)
    export(network, tmp_path / "network.onnx", SIDE_PX)
    exported = onnxruntime.InferenceSession(tmp_path / "network.onnx")
    with torch.inference_mode():
        expected = network(torch.from_numpy(picture)).numpy()
    (answer,) = exported.run(None, {"image": picture})
    np.testing.assert_allclose(answer, expected, atol=0.01)  # weights are rounded to fp16


def test_a_second_opinion_is_added_in_the_file_too_and_read_back(network: Network, tmp_path: Path) -> None:
    picture = np.random.default_rng(0).uniform(-1, 1, (1, 3, SIDE_PX, SIDE_PX)).astype(np.float32)
    with torch.no_grad():
        network.keep_pools((10, 14, 20), [torch.rand(1, 3, SIDE_PX, SIDE_PX)])
        alone = network(torch.from_numpy(picture))
        network.second = Second(classes=6, share=1.5, foul_share=0.75, alone=2.0, nothing_share=0.5)
        network.second.nothing.bias.fill_(3.0)
        for layer in (network.second.clear, network.second.foul):
            layer.weight *= 5
            layer.weight[:, 0] = 100.0  # for all classes alike, and large beside the others
        both = network(torch.from_numpy(picture))
        torch.testing.assert_close(both, network.second(torch.from_numpy(picture), alone))
    assert float((both - alone).abs().max()) > 0.05
    path, small = tmp_path / "network.onnx", tmp_path / "small.onnx"
    export(network, path, SIDE_PX)
    small.write_bytes(compact(path.read_bytes()))
    (answer,) = onnxruntime.InferenceSession(path).run(None, {"image": picture})
    np.testing.assert_allclose(answer, both.numpy(), atol=0.02)
    for file, tolerance in ((path, 0.02), (small, 0.3)):
        with torch.inference_mode():
            again = exported(file).eval()(torch.from_numpy(picture)).numpy()
        np.testing.assert_allclose(again, both.numpy(), atol=tolerance)


def test_a_copy_looks_at_its_own_features(network: Network) -> None:
    average = torch.optim.swa_utils.AveragedModel(network).module
    picture = torch.rand(1, 3, SIDE_PX, SIDE_PX)
    with torch.inference_mode():
        expected = network(picture)
        network(1 - picture)
        torch.testing.assert_close(average(picture), expected)


def test_moved_back_it_keeps_its_head_and_a_share_of_what_it_learnt(network: Network) -> None:
    before = {name: value.clone() for name, value in network.body.state_dict().items()}
    with torch.no_grad():
        network.body._conv_head.weight += 1
        network.body._bn1.running_var *= 2
        network.body._fc.weight += 1
    network.towards_pretrained(0.25)
    after = network.body.state_dict()
    torch.testing.assert_close(after["_conv_head.weight"], before["_conv_head.weight"] + 0.75)
    torch.testing.assert_close(after["_bn1.running_var"], before["_bn1.running_var"] * 1.75)
    torch.testing.assert_close(after["_fc.weight"], before["_fc.weight"] + 1)
    torch.testing.assert_close(after["_blocks.20._bn2.weight"], before["_blocks.20._bn2.weight"])


def test_a_pool_that_is_left_out_counts_as_its_mean(network: Network, tmp_path: Path) -> None:
    pictures = torch.rand(3, 2, 3, SIDE_PX, SIDE_PX)
    with torch.no_grad():
        before = network(pictures.flatten(0, 1)).mean(0)
        network.keep_pools((14, 20), pictures)
        after = network(pictures.flatten(0, 1)).mean(0)
    assert network.pooled_blocks == (14, 20)
    torch.testing.assert_close(after, before)
    export(network, tmp_path / "network.onnx", SIDE_PX)
    exported = onnxruntime.InferenceSession(tmp_path / "network.onnx")
    with torch.inference_mode():
        expected = network(pictures[0, :1]).numpy()
    (answer,) = exported.run(None, {"image": pictures[0, :1].numpy()})
    np.testing.assert_allclose(answer, expected, atol=0.01)


def test_an_exported_network_is_read_back_as_it_is(network: Network, tmp_path: Path) -> None:
    with torch.no_grad():
        network.keep_pools((10, 14, 20), [torch.rand(1, 3, SIDE_PX, SIDE_PX)])
    export(network, tmp_path / "first.onnx", SIDE_PX)
    export(exported(tmp_path / "first.onnx").eval(), tmp_path / "second.onnx", SIDE_PX)
    picture = np.random.default_rng(0).uniform(-1, 1, (1, 3, SIDE_PX, SIDE_PX)).astype(np.float32)
    first, second = (
        onnxruntime.InferenceSession(tmp_path / f"{name}.onnx").run(None, {"image": picture})[0]
        for name in ("first", "second")
    )
    np.testing.assert_allclose(second, first, atol=0.01)


def test_weights_in_another_file_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever lists a hash has seen what is hashed, and nothing beside it."""
    (tmp_path / PREPROCESSING).write_bytes((MODEL_DIR / PREPROCESSING).read_bytes())
    onnx.save(
        onnx.load(MODEL_DIR / WEIGHTS),
        tmp_path / WEIGHTS,
        save_as_external_data=True,
        location="beside.bin",
        size_threshold=0,
    )
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BrokenModel):
        Classifier(tmp_path)

"""Training needs packages that a site does not."""

from __future__ import annotations

import subprocess
import sys

import pytest

WITHOUT_TORCH = """
import importlib.util, runpy, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "torch" else find(name, *more)
sys.argv = ["train", "--data", "x"]
runpy.run_module("training.train", run_name="__main__")
"""


def test_training_without_its_packages_says_what_to_install() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT_TORCH], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "pip install --constraint constraints.txt -r training/requirements.txt" in done.stderr


def test_training_replaces_the_installed_model_only_where_it_is_named() -> None:
    pytest.importorskip("torch", reason="needs pip install -r training/requirements.txt")
    command = [sys.executable, "-m", "training.train", "--data", "x"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2 and "required: --out" in done.stderr

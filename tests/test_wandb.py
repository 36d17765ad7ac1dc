"""Weights & Biases, which logs what TensorBoard shows (``train.wandb``)."""

import sys
from pathlib import Path

import pytest

from policies.cli.main import status

WORDS = ["train", "learner.kind=ppo", "env.scenario=toy-4x4-v0", "train.episodes=40",
         "train.games=2", "train.figures=false", "train.wandb=true", "out=run"]  # fmt: skip


def test_offline_runs_hold_the_curves(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("wandb")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("WANDB_MODE", "offline")
    assert status(WORDS) == 0
    (file,) = Path("run", "wandb").glob("offline-run-*/*.wandb")
    for curve in (b"reward/train", b"mean/greedy_wirelength"):
        assert curve in file.read_bytes()


def test_without_the_package_one_line_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "wandb", None)
    assert status(WORDS) == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert error == "marouting: train.wandb: expected the package wandb (pip install wandb)"
    assert status([*WORDS, "train.tensorboard=false"]) == 2
    assert "train.wandb: expected false without train.tensorboard" in capsys.readouterr().err

"""All lines with palpate on the page for users of OpenVSF run."""

import re
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from stand_in import PointVSF, Tensor

import palpate
from palpate import openvsf

PAGE = Path(__file__).resolve().parents[3] / "docs" / "guide" / "src" / "openvsf.md"

STUDY = """
dataset: {keys: {angles: 7, torques: 7}}
train_sequences: [0, 1]
test_sequences: [10]
"""


@pytest.fixture
def library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Substitutes for OpenVSF and torch."""
    for name, offer, thing in [("vsf", "PointVSF", PointVSF), ("torch", "from_numpy", Tensor)]:
        module = ModuleType(name)
        setattr(module, offer, thing)
        monkeypatch.setitem(sys.modules, name, module)


@pytest.mark.usefixtures("library")
def test_a_live_field_has_copies_of_all_springs(field: palpate.Field) -> None:
    vsf = openvsf.to_point_vsf(field)
    assert not np.shares_memory(vsf.stiffness.numpy(), field.stiffness)
    assert vsf.features["N_obs"].numpy().dtype == np.int64
    back = openvsf.from_point_vsf(vsf)
    for name in ("stiffness", "std", "counts"):
        assert (getattr(back, name) == getattr(field, name)).all(), name
    assert np.abs(back.points - field.points).max() < 1e-12


@pytest.mark.usefixtures("library")
def test_every_line_of_the_page_runs(
    plant: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "data").symlink_to(plant.parent)
    (tmp_path / "study.yaml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    page = PAGE.read_text()
    blocks = re.findall(r"<!-- palpate -->\n```python\n(.*?)```", page, re.DOTALL)
    of_openvsf = re.findall(r"<!-- (?:OpenVSF|first) -->\n```python\n", page)
    assert len(blocks) + len(of_openvsf) == page.count("```python")
    names: dict[str, Any] = {}
    for block in blocks:
        exec(compile(block, str(PAGE), "exec"), names)
    average, zero = re.findall(r"[\d.]+", capsys.readouterr().out)[:2]
    assert 0.0 < float(average) < float(zero)
    inlines = re.findall(r"`(palpate\.\w+\(study[^`]*)\)`", page)
    assert len(inlines) == 2
    for inline in inlines:
        fewer = ", methods=['zero']" if "evaluate" in inline else ""
        exec(f"{inline}{fewer})", names)


def test_every_public_name_is_on_the_page() -> None:
    for name in openvsf.__all__:
        assert getattr(openvsf, name).__doc__
        assert name in PAGE.read_text(), name

"""The stub agrees with the module; the tutorial and the package are strictly typed."""

import ast
import inspect
import json
import subprocess
import sys
from pathlib import Path

import palpate
from palpate import _palpate

HERE = Path(__file__).resolve().parents[1]
TUTORIAL = HERE / "tutorial.ipynb"


def test_needs_mypy_the_stub_is_the_module() -> None:
    command = [sys.executable, "-m", "mypy.stubtest", "palpate"]
    done = subprocess.run(command, capture_output=True, text=True, cwd=HERE)
    assert done.returncode == 0, done.stdout + done.stderr


def test_docstrings_of_the_stub_are_those_of_the_module() -> None:
    stub = ast.parse((HERE / "python/palpate/_palpate.pyi").read_text())
    for node in stub.body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef):
            continue
        thing = getattr(_palpate, node.name)
        assert inspect.getdoc(thing) == ast.get_docstring(node), node.name
        for item in node.body if isinstance(node, ast.ClassDef) else []:
            if isinstance(item, ast.FunctionDef) and not item.name.startswith("_"):
                docstring = inspect.getdoc(getattr(thing, item.name))
                assert docstring == ast.get_docstring(item), f"{node.name}.{item.name}"
                assert docstring, f"{node.name}.{item.name} says nothing"


def test_every_public_name_exists_and_has_a_docstring() -> None:
    assert sorted(palpate.__all__) == palpate.__all__
    for name in palpate.__all__:
        assert getattr(palpate, name).__doc__


def test_needs_mypy_the_package_its_tests_and_the_tutorial_are_typed(tmp_path: Path) -> None:
    notebook = json.loads(TUTORIAL.read_text())
    code = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    exported = tmp_path / "tutorial.py"
    exported.write_text("\n\n".join(code) + "\n")
    command = [sys.executable, "-m", "mypy", "--strict", "--cache-dir", str(tmp_path / "cache")]
    targets = [str(exported), str(HERE / "python/palpate"), str(HERE / "tests")]
    for target in targets:
        done = subprocess.run([*command, target], capture_output=True, text=True, cwd=tmp_path)
        assert done.returncode == 0, f"{target}\n{done.stdout}{done.stderr}"

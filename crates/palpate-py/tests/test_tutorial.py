"""The tutorial runs from its start to its end."""

import time
from pathlib import Path
from typing import Any

TUTORIAL = Path(__file__).resolve().parents[1] / "tutorial.ipynb"


def test_needs_jupyter_the_tutorial_runs_and_is_kept_without_outputs() -> None:
    import nbformat
    from nbclient import NotebookClient

    notebook: Any = nbformat.read(TUTORIAL, as_version=4)  # type: ignore[no-untyped-call]
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert all(not cell.outputs and cell.execution_count is None for cell in code)
    started = time.perf_counter()
    resources = {"metadata": {"path": str(TUTORIAL.parent)}}
    NotebookClient(notebook, timeout=300, kernel_name="python3", resources=resources).execute()
    print(f"tutorial: {time.perf_counter() - started:.1f} s")
    shown = [output for cell in code for output in cell.outputs]
    assert sum("image/png" in output.get("data", {}) for output in shown) >= 2
    assert not any(output.output_type == "error" for output in shown)

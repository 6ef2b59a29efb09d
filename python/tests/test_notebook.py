"""The notebook runs from its first to its last cell, draws, and is stored with its outputs."""

import pytest
from conftest import DATA


def printed(notebook):
    """What the cells print, in one text."""
    outputs = [o for cell in notebook.cells if cell.cell_type == "code" for o in cell.outputs]
    return "".join(o["text"] for o in outputs if o.output_type == "stream" and o.name == "stdout")


# Fails if a cell of the notebook fails, draws nothing, no longer calibrates the data, or prints other than what is stored
# with it: store it again with `jupyter execute --inplace`.
def test_the_notebook_calibrates_and_draws():
    nbformat = pytest.importorskip("nbformat")
    client = pytest.importorskip("nbclient")
    folder = DATA.parents[1] / "python" / "examples"
    notebook = nbformat.read(folder / "mukca.ipynb", as_version=4)
    stored = printed(notebook)
    client.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(folder)}}).execute()
    outputs = [o for cell in notebook.cells if cell.cell_type == "code" for o in cell.outputs]
    assert not [o for o in outputs if o.output_type == "error"]
    assert [o for o in outputs if "image/png" in o.get("data", {})]
    text = printed(notebook)
    assert text == stored
    assert "180 rows" in text and "Held out by place (3 values)" in text and "expected error" in text

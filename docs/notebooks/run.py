"""Run the notebooks and store their results: ``make notebooks``.

Each runs in an empty folder. Neither times nor the texts of what has a table or a picture are
stored.
"""

import tempfile
from pathlib import Path

import nbformat
from nbclient import NotebookClient

from energyplan import __version__

for file in sorted(Path(__file__).parent.glob("*.ipynb")):
    notebook = nbformat.read(file, as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        place = {"metadata": {"path": folder}}
        client = NotebookClient(
            notebook, record_timing=False, coalesce_streams=True, resources=place
        )
        client.execute()
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            if output.get("data", {}).keys() & {"text/html", "image/png"}:
                output["data"].pop("text/plain", None)
    notebook.metadata["language_info"] = {"name": "python"}
    notebook.metadata["energyplan"] = __version__
    nbformat.write(notebook, file)

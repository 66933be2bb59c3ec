"""CSV and MATLAB: pandas and SciPy read the numbers and the units of the flight."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat

from lunarsim.errors import InputError
from lunarsim.exports import export_flight

TABLES = ("trajectory", "navigation", "commands", "scans", "candidates")


def saved(folder, name):
    """Return columns and units of a table of the record."""
    table = pq.read_table(folder / f"{name}.parquet")
    metadata = table.schema.metadata
    units = {c: metadata[f"unit:{c}".encode()].decode() for c in table.column_names}
    return {c: table[c].to_numpy() for c in table.column_names}, units


@pytest.mark.parametrize("name", TABLES)
def test_csv_files_have_the_tables_with_units(flight, saved_flight, tmp_path, name):
    folder = export_flight(flight, "csv", tmp_path / "tables")
    assert {path.name for path in folder.iterdir()} == {f"{table}.csv" for table in TABLES}
    found = pd.read_csv(folder / f"{name}.csv")
    columns, units = saved(saved_flight, name)
    assert list(found.columns) == [f"{c} ({units[c]})" for c in columns]
    for c, values in columns.items():
        np.testing.assert_array_equal(
            found[f"{c} ({units[c]})"].to_numpy().astype(values.dtype), values
        )


@pytest.mark.parametrize("name", TABLES)
def test_a_mat_file_has_structs_with_units(flight, saved_flight, tmp_path, name):
    path = export_flight(flight, "matlab", tmp_path / "flight.mat")
    content = loadmat(path, simplify_cells=True)
    columns, units = saved(saved_flight, name)
    assert set(content[name]) == set(columns)
    assert content["units"][name] == units
    for c, values in columns.items():
        np.testing.assert_array_equal(content[name][c], values)
    assert "true ENU" in content["frames"]["trajectory"]["position_x"]


def test_a_mat_file_has_column_vectors_and_the_outcome(flight, tmp_path):
    path = export_flight(flight, "matlab", tmp_path / "flight.mat")
    content = loadmat(path, struct_as_record=False, squeeze_me=False)
    trajectory = content["trajectory"][0, 0]
    assert trajectory.time.shape == (len(flight.trajectory["time"]), 1)
    simple = loadmat(path, simplify_cells=True)["flight"]
    assert bool(simple["safe"]) == flight.outcome.safe and simple["policy"] == "safest"
    np.testing.assert_array_equal(simple["target"], flight.target)
    assert "[terrain]" in simple["scenario"]


def test_a_folder_with_files_is_not_touched(flight, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(InputError, match="--out: must be a new or empty folder"):
        export_flight(flight, "csv", tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]

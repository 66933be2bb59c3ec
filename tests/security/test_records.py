"""A damaged record of a flight is one error that names the file; it reads no other folder."""

from __future__ import annotations

import json
import os
import shutil

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lunarsim.errors import InputError
from lunarsim.scenario import Scenario
from lunarsim.simulation import Simulation
from lunarsim.simulation.flight import Flight
from lunarsim.simulation.flight_files import digest_of
from lunarsim.simulation.map_record import map_remarks_by_mapper
from tests.security import fuzz
from tests.worlds import TINY_FLIGHT


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    flight = Simulation(Scenario.from_dict(TINY_FLIGHT), 1, "safest").run()
    assert flight.maps and flight.decisions
    return flight.save(tmp_path_factory.mktemp("record") / "flight")


@pytest.fixture
def folder(saved, tmp_path):
    return shutil.copytree(saved, tmp_path / "flight")


def use(folder):
    """Load a record and use what figures and metrics are made from."""
    flight = Flight.load(folder)
    _ = flight.positions, flight.sites, flight.propellant_used, flight.duration, flight.lost
    _ = flight.first_lost_time, flight.divert_distance, flight.map_error, flight.hazard_map
    map_remarks_by_mapper(flight.maps, flight.decision_mapper)
    assert all(isinstance(float(e["time"]), float) for e in flight.events)
    return flight


def forge(folder, name, write):
    """Change a file and the digest of it."""
    write(folder / name)
    tables = json.loads((folder / "flight.json").read_text())
    if name in tables["digests"]:
        tables["digests"][name] = digest_of(folder / name)
        (folder / "flight.json").write_text(json.dumps(tables))


def edit(folder, change):
    tables = json.loads((folder / "flight.json").read_text())
    change(tables)
    (folder / "flight.json").write_text(json.dumps(tables))


def test_every_file_has_its_digest(folder):
    names = {str(p.relative_to(folder)) for p in folder.rglob("*") if p.is_file()}
    tables = json.loads((folder / "flight.json").read_text())
    assert set(tables["digests"]) == names - {"flight.json"}
    del tables["digests"]
    (folder / "flight.json").write_text(json.dumps(tables))
    use(folder)  # a record of before there were digests


@pytest.mark.parametrize("target", [[0.0, float("nan"), 0.0], [0.0, 0.0], None, "here"])
def test_the_target_is_a_point(folder, target):
    edit(folder, lambda tables: tables.update(target=target))
    with pytest.raises(InputError, match=r"flight\.json"):
        use(folder)


@pytest.mark.parametrize(
    "name", ["trajectory.parquet", "scans.parquet", "candidates.parquet", "maps/dem.nc"]
)
def test_flipped_bits_missing_and_cut_files_are_noticed(folder, name):
    whole = (folder / name).read_bytes()
    rng = np.random.default_rng(1)
    damages = [fuzz.damaged_bytes(whole, rng) for _ in range(20)]
    for data in (*(d for d in damages if d != whole), b"", whole[:100], None):
        (folder / name).unlink()
        if data is not None:
            (folder / name).write_bytes(data)
        with pytest.raises(InputError, match=name.replace(".", r"\.")) as caught:
            Flight.load(folder)
        assert len(str(caught.value).replace(str(folder), "")) < 230
        assert "repeat the flight" in str(caught.value)
        (folder / name).write_bytes(whole)
    use(folder)


@pytest.mark.parametrize(
    "name", ["../dem", "/etc/dem", "a/b", "..", "", "dem\n", "dem.nc", None, 3]
)
def test_a_map_lies_in_its_folder(folder, name):
    edit(folder, lambda t: t.update(maps=[name]))
    with pytest.raises(InputError, match=r"maps\.0.*flight\.json'"):
        Flight.load(folder)


def test_a_link_out_of_the_folder_is_refused(folder, tmp_path):
    (tmp_path / "secret").write_text("secret")
    digest = digest_of(tmp_path / "secret")
    edit(folder, lambda t: t["digests"].update({"../secret": digest}))
    with pytest.raises(InputError, match="outside the folder"):
        Flight.load(folder)
    for name in ("maps/dem.nc", "trajectory.parquet"):
        shutil.move(folder / name, tmp_path / "elsewhere")
        (folder / name).symlink_to(tmp_path / "elsewhere")
        for change in (lambda t: None, lambda t: t.pop("digests", None)):
            edit(folder, change)
            with pytest.raises(InputError, match="link, pipe or device"):
                Flight.load(folder)
        (folder / name).unlink()
        shutil.move(tmp_path / "elsewhere", folder / name)


@pytest.mark.parametrize("name", ["maps/dem.nc", "trajectory.parquet", "scans.parquet"])
@pytest.mark.parametrize("digests", [True, False])
def test_a_pipe_in_a_record_is_refused(folder, name, digests):
    if not digests:
        edit(folder, lambda t: t.pop("digests"))
    (folder / name).unlink()
    os.mkfifo(folder / name)
    with fuzz.at_most(10.0), pytest.raises(InputError, match="link, pipe or device"):
        Flight.load(folder)


@pytest.mark.parametrize("how", ["link", "external", "virtual"])
def test_a_map_reads_no_other_file(folder, tmp_path, how):
    secret = tmp_path / "secret.h5"
    with h5py.File(folder / "maps" / "dem.nc") as file:
        p = file["p_safe"][()]
    with h5py.File(secret, "w") as file:
        file["p_safe"] = p
    (tmp_path / "raw").write_bytes(p.tobytes())

    def write(path):
        with h5py.File(path, "a") as file:
            del file["p_safe"]
            if how == "link":
                file["p_safe"] = h5py.ExternalLink(str(secret), "p_safe")
            elif how == "external":
                parts = [(str(tmp_path / "raw"), 0, p.nbytes)]
                file.create_dataset("p_safe", p.shape, p.dtype, external=parts)
            else:
                layout = h5py.VirtualLayout(p.shape, p.dtype)
                layout[:] = h5py.VirtualSource(str(secret), "p_safe", p.shape)
                file.create_virtual_dataset("p_safe", layout)

    forge(folder, "maps/dem.nc", write)
    with pytest.raises(InputError, match="is a link to other data"):
        Flight.load(folder)


def test_columns_are_checked_once_at_reading(folder):
    """Also where the digest was made to fit."""
    table = pq.read_table(folder / "trajectory.parquet")
    column = table.column_names.index("mass")
    n = len(table)
    for wrong in (
        table.drop_columns(["mass"]),
        table.slice(0, 0),
        table.set_column(column, "mass", pa.array(["x"] * n)),
        table.set_column(column, "mass", pa.array([None] * n, pa.float64())),
        table.set_column(column, "mass", pa.array([[1.0]] * n)),
        table.set_column(0, "time", pa.array([float("nan")] * n)),
    ):
        forge(folder, "trajectory.parquet", lambda path, t=wrong: pq.write_table(t, path))
        with pytest.raises(InputError, match="trajectory"):
            Flight.load(folder)


def test_a_small_file_does_not_expand_to_gigabytes(folder):
    table = pa.table(dict.fromkeys(pq.read_schema(folder / "scans.parquet").names,
                                   pa.array(np.zeros(10_000_000, np.float32))))  # fmt: skip
    forge(folder, "scans.parquet", lambda path: pq.write_table(table, path))
    assert (folder / "scans.parquet").stat().st_size < 1_000_000
    with pytest.raises(InputError, match="when decompressed"):
        Flight.load(folder)


def damaged(folder, saved, seed):
    """Damage one file of a record; tables half of the times, without their digests."""
    rng = np.random.default_rng(seed)
    tables = json.loads((saved / "flight.json").read_text())
    names = sorted(tables.pop("digests"))
    (folder / "flight.json").write_text(json.dumps(tables))
    for name in names:
        (folder / name).write_bytes((saved / name).read_bytes())
    if rng.random() < 0.5:
        (folder / "flight.json").write_bytes(fuzz.damaged_json(tables, rng))
    else:
        name = names[int(rng.integers(len(names)))]
        (folder / name).write_bytes(fuzz.damaged_bytes((saved / name).read_bytes(), rng))


def test_damaged_records_end_in_one_error(folder, saved):
    for seed in range(60):
        damaged(folder, saved, seed)
        fuzz.survives(lambda: use(folder), f"record {seed}")

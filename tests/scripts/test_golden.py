"""Digests of results detect exactly the changed quantities."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from tests.conftest import ROOT

sys.path.insert(0, str(ROOT / "scripts"))

import golden
from golden_parts.digests import digests_of_folder


@pytest.fixture
def folder(tmp_path):
    pq.write_table(
        pa.table({"time": [0.0, 1.0], "thrust_n": [600.0, np.nan]}), tmp_path / "a.parquet"
    )
    (tmp_path / "flight.json").write_text(
        json.dumps({"landed": True, "provenance": {"commit": "abc"}, "verdict": {"tilt": 0.1}})
    )
    return tmp_path


def test_one_changed_bit_is_detected(folder):
    before = digests_of_folder(folder)
    assert list(golden.changes("case", before, digests_of_folder(folder))) == []
    value = np.nextafter(600.0, 601.0)
    pq.write_table(
        pa.table({"time": [0.0, 1.0], "thrust_n": [value, np.nan]}), folder / "a.parquet"
    )
    (line,) = golden.changes("case", before, digests_of_folder(folder))
    assert line.startswith("changed: case: a.parquet:thrust_n: float64 (2,), mean 600")


def test_provenance_is_not_compared(folder):
    before = digests_of_folder(folder)
    text = (folder / "flight.json").read_text()
    (folder / "flight.json").write_text(text.replace("abc", "def"))
    assert digests_of_folder(folder) == before
    (folder / "flight.json").write_text(text.replace("0.1", "0.2"))
    (line,) = golden.changes("case", before, digests_of_folder(folder))
    assert "flight.json:outcome.tilt" in line


def test_names_of_earlier_versions_count_as_the_current_ones(folder):
    old = 'name = "two_eyes"\n[policy]\nenough = 0.9\n[variation]\nload_kg = 5.0\n'
    new = 'name = "camera_and_lidar"\n[domain_randomization]\npayload_kg = 5.0\n'
    new += "[policy]\np_safe_min = 0.9\n"
    flight = {"scenario": old, "events": [{"time": 1.0, "name": "doubted"}], "verdict": {}}
    renamed = {"scenario": new, "events": [{"time": 1.0, "name": "covariance-inflated"}]}
    found = []
    for scenario, record in ((old, flight), (new, renamed | {"outcome": {}})):
        (folder / "flight.json").write_text(json.dumps(record))
        (folder / "scenario.toml").write_text(scenario)
        found.append(digests_of_folder(folder))
    assert found[0] == found[1]
    (folder / "scenario.toml").write_text(new.replace("0.9", "0.8"))
    (line,) = golden.changes("case", found[0], digests_of_folder(folder))
    assert line.startswith("changed: case: scenario.toml:values")


def test_renamed_quantity_is_not_a_changed_result(folder):
    before = digests_of_folder(folder)
    pq.write_table(pa.table({"t": [0.0, 1.0], "thrust_n": [600.0, np.nan]}), folder / "a.parquet")
    assert list(golden.changes("case", before, digests_of_folder(folder))) == [
        "renamed: case: a.parquet:time -> a.parquet:t"
    ]
    (folder / "a.parquet").unlink()
    lines = list(golden.changes("case", before, digests_of_folder(folder)))
    assert [line.partition(":")[0] for line in lines] == ["removed", "removed"]


def test_check_without_record_names_the_command(tmp_path):
    code = f"import golden; golden.OUT = golden.Path({str(tmp_path)!r}); golden.main()"
    done = subprocess.run(
        [sys.executable, "-c", code, "check"],
        cwd=ROOT / "scripts",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "golden.py record" in done.stderr

"""The gallery, small."""

from __future__ import annotations

import subprocess
import sys

from tests.conftest import SCENARIOS


def test_gallery_renders_a_scene_and_fits_the_rocks(tmp_path):
    script = SCENARIOS / "terrain" / "gallery.py"
    for only in ("hirise", "rocks"):
        command = [sys.executable, str(script), "--only", only, "--out", str(tmp_path)]
        subprocess.run(command, capture_output=True, text=True, check=True)
    assert (tmp_path / "hirise.png").stat().st_size > 20_000
    assert (tmp_path / "rock_sizes.png").exists()

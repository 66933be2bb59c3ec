"""A terrain file reads no other folder and no network, and no broken one ends in a traceback."""

from __future__ import annotations

import http.server
import os
import shutil
import threading

import h5py
import numpy as np
import pytest
import rasterio
from click.testing import CliRunner

from lunarsim.cli import main
from lunarsim.errors import InputError
from lunarsim.world.terrain.dtm import load_terrain, read_info
from tests.security import fuzz
from tests.world.terrain.rasters import Case, equirectangular, plane

pytestmark = [
    pytest.mark.filterwarnings("ignore::PendingDeprecationWarning"),
    pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning"),
]

Z = np.arange(64, dtype="<i2").reshape(8, 8)


@pytest.fixture
def server():
    """Return the URL of a raster on this machine, and the requests that it got."""
    requests = []

    class Handler(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            requests.append(self.path)
            self.send_error(404)

        do_HEAD = do_GET  # noqa: N815

        def log_message(self, *args):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as service:
        threading.Thread(target=service.serve_forever, daemon=True).start()
        yield f"http://127.0.0.1:{service.server_port}/z.tif", requests
        service.shutdown()


def tiff(path):
    with rasterio.open(
        path, "w", driver="GTiff", height=8, width=8, count=1, dtype="int16"
    ) as file:  # fmt: skip
        file.write(Z, 1)
    return path


def vrt(source):
    return (
        '<VRTDataset rasterXSize="8" rasterYSize="8"><VRTRasterBand dataType="Int16" band="1">'
        f'<SimpleSource><SourceFilename relativeToVRT="0">{source}</SourceFilename>'
        "<SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>"
    )


def pds3(image, before=""):
    return (
        "PDS_VERSION_ID = PDS3\nRECORD_TYPE = FIXED_LENGTH\nRECORD_BYTES = 16\nFILE_RECORDS = 8\n"
        f'{before}^IMAGE = "{image}"\nOBJECT = IMAGE\n LINES = 8\n LINE_SAMPLES = 8\n'
        " SAMPLE_TYPE = LSB_INTEGER\n SAMPLE_BITS = 16\nEND_OBJECT = IMAGE\nEND\n"
    )


def compressed(file):
    """Return a label whose compressed image is another raster, which GDAL opens by any driver."""
    return (
        f'PDS_VERSION_ID = PDS3\nOBJECT = COMPRESSED_FILE\n FILE_NAME = "{file}"\n'
        ' RECORD_TYPE = UNDEFINED\n ENCODING_TYPE = "JP2"\nEND_OBJECT = COMPRESSED_FILE\n'
        'OBJECT = UNCOMPRESSED_FILE\n FILE_NAME = "x.img"\n RECORD_TYPE = FIXED_LENGTH\n'
        ' RECORD_BYTES = 16\n FILE_RECORDS = 8\n ^IMAGE = "x.img"\nOBJECT = IMAGE\n LINES = 8\n'
        " LINE_SAMPLES = 8\n SAMPLE_TYPE = LSB_INTEGER\n SAMPLE_BITS = 16\nEND_OBJECT = IMAGE\n"
        "END_OBJECT = UNCOMPRESSED_FILE\nEND\n"
    )


def isis3(core, kind="BandSequential"):
    return (
        f"Object = IsisCube\n Object = Core\n StartByte = 1\n ^Core = {core}\n Format = {kind}\n"
        " Group = Dimensions\n Samples = 8\n Lines = 8\n Bands = 1\n End_Group\n"
        " Group = Pixels\n Type = SignedWord\n ByteOrder = Lsb\n Base = 0\n Multiplier = 1\n"
        " End_Group\n End_Object\nEnd_Object\nEnd\n"
    )


def hostile_files(folder, target):
    """Write files that lead to a target by every way that is known; return their paths."""
    (folder / "z.vrt").write_text(vrt(target))
    shutil.copy(folder / "z.vrt", folder / "vrt.tif")
    for name, text in {
        "url.tif": str(target),
        "wms.xml": f"<GDAL_WMS><Service name='TMS'><ServerUrl>{target}</ServerUrl></Service>"
        "<DataWindow><SizeX>8</SizeX><SizeY>8</SizeY></DataWindow></GDAL_WMS>",
        "image.lbl": pds3(target),
        "compressed.lbl": compressed("z.vrt"),
        "core.cub": isis3(target),
        "core_tiff.cub": isis3("vrt.tif", "GeoTIFF"),
    }.items():
        (folder / name).write_text(text)
    label = Case("PDS4", equirectangular(0.0), dtype="int16").write(folder)
    for name, file in (("pds4.xml", target), ("pds4_vrt.xml", "vrt.tif")):
        text = label.read_text().replace("<file_name>z.img", f"<file_name>{file}")
        (folder / name).write_text(text)
    label.unlink()
    for sidecar in ("ovr", "msk"):
        tiff(folder / f"{sidecar}.tif")
        (folder / f"{sidecar}.tif.{sidecar}").write_text(vrt(target))
    for name, file in (("overview.tif", folder / "z.vrt"), ("overview_url.tif", target)):
        tiff(folder / name)
        (folder / f"{name}.aux.xml").write_text(
            '<PAMDataset><Metadata domain="OVERVIEWS">'
            f'<MDI key="OVERVIEW_FILE">{file}</MDI></Metadata></PAMDataset>'
        )
    ends = (".aux.xml", ".ovr", ".msk", ".img")
    return sorted(p for p in folder.iterdir() if not p.name.endswith(ends))


def try_to_read(path):
    """Read a file in all ways; return the error, None if it is read."""
    error = None
    for use in (read_info, lambda p: load_terrain(p, posting=10.0)):
        try:
            use(path)
        except InputError as caught:
            error = caught
            assert path.name in str(caught) or caught.field == "terrain.dtm_posting_m"
    return error


@pytest.mark.parametrize("way", ["/vsicurl/{}", "{}"])
def test_no_file_reaches_the_network(server, tmp_path, way):
    url, requests = server
    paths = hostile_files(tmp_path, way.format(url))
    assert len(paths) > 12
    read = [path.name for path in paths if try_to_read(path) is None]
    assert requests == []
    # GDAL does not open the first, and reads the second as bytes.
    assert set(read) <= {"overview_url.tif", "pds4_vrt.xml"}


def test_no_file_reads_another_folder(tmp_path):
    outside, folder = tmp_path / "outside", tmp_path / "terrain"
    outside.mkdir()
    folder.mkdir()
    tiff(outside / "z.tif")
    read = [p.name for p in hostile_files(folder, outside / "z.tif") if try_to_read(p) is None]
    # The samples of the last are the bytes of a file in the same folder.
    assert read in ([], ["pds4_vrt.xml"])
    (outside / "z.img").write_bytes(Z.tobytes())
    (folder / "up.lbl").write_text(pds3("../outside/z.img"))
    (folder / "down.lbl").write_text(pds3(str(outside / "z.img")))
    for name in ("up", "down"):
        with pytest.raises(
            InputError, match=r"files in its own folder|PDS label that GDAL cannot read"
        ):
            load_terrain(folder / f"{name}.lbl", posting=1.0)
    with pytest.raises(InputError, match="must not be a VRT, which refers to other files"):
        load_terrain(folder / "z.vrt")


@pytest.mark.parametrize("way", ["external samples", "virtual samples", "link"])
def test_no_netcdf_file_reads_another_file(tmp_path, way):
    """HDF5 can lay samples into any file; GDAL does not list it among its parts."""
    outside, path = tmp_path / "outside", tmp_path / "z.nc"
    with h5py.File(outside, "w") as file:
        file["z"] = Z
    with h5py.File(path, "w") as file:
        group = file.create_group("deep")
        if way == "external samples":
            group.create_dataset("z", Z.shape, "<i2", external=[(str(outside), 0, Z.nbytes)])
        elif way == "virtual samples":
            layout = h5py.VirtualLayout(shape=Z.shape, dtype="<i2")
            layout[:] = h5py.VirtualSource(str(outside), "z", shape=Z.shape)
            group.create_virtual_dataset("z", layout)
        else:
            group["z"] = h5py.ExternalLink(str(outside), "z")
    with pytest.raises(InputError, match="'deep/z' stored in another file"):
        load_terrain(path, posting=1.0)


def test_links_of_the_user_are_followed(tmp_path):
    """A link in a project to data elsewhere is the user's own choice."""
    data, project = tmp_path / "data", tmp_path / "project"
    data.mkdir()
    project.mkdir()
    path = Case("PDS", equirectangular(0.0), dtype="float32").write(data)
    for name in (path.name, path.with_suffix(".lbl").name):
        (project / name).symlink_to(data / name)
    assert load_terrain(project / path.name).grid.shape == load_terrain(path).grid.shape


@pytest.mark.parametrize("name", ["/vsicurl/http://127.0.0.1/z.tif", "http://127.0.0.1/z.tif",
                                  "/vsimem/z.tif", "/vsizip/a.zip/z.tif", "NETCDF:z.nc:z",
                                  "zip://a.zip!z.tif"])  # fmt: skip
def test_names_that_are_no_files_are_refused(name):
    done = CliRunner().invoke(main, ["terrain", "info", name])
    assert done.exit_code == 2
    assert "must be an existing raster file" in done.output


@pytest.mark.parametrize("driver", ["PNG", "HFA", "GSBG", "JPEG"])
def test_other_formats_are_refused_by_name(tmp_path, driver):
    path = tmp_path / "z.img"
    with rasterio.open(
        path, "w", driver=driver, height=8, width=8, count=1,
        dtype="float32" if driver == "GSBG" else "uint8",
    ) as file:  # fmt: skip
        file.write(Z.astype(file.dtypes[0]), 1)
    with pytest.raises(InputError, match=r"must be a raster of GTiff"):
        load_terrain(path)


def test_the_format_counts_and_not_the_suffix(tmp_path):
    path = Case(map=plane('LOCAL_CS["s",UNIT["metre",1]]', 1.0)).write(tmp_path)
    assert load_terrain(path.rename(tmp_path / "z.png")).grid.posting == 1.0


BROKEN = {
    "GTiff": Case(map=equirectangular(60.0), dtype="float32"),
    "PDS": Case("PDS", equirectangular(60.0), dtype="float32"),
    "PDS4": Case("PDS4", equirectangular(60.0), dtype="float32"),
    "ISIS3": Case("ISIS3", equirectangular(60.0), dtype="float32"),
    "netCDF": Case("netCDF", equirectangular(60.0), dtype="float32"),
    "AAIGrid": Case("AAIGrid", equirectangular(60.0)),
    "ENVI": Case("ENVI", equirectangular(60.0), dtype="float32"),
}


@pytest.mark.parametrize("driver", BROKEN)
def test_broken_files_are_read_or_refused_by_name(tmp_path, driver):
    """Whatever is cut off or overwritten, GDAL's and PROJ's errors name the file."""
    path = BROKEN[driver].write(tmp_path)
    parts = {p: p.read_bytes() for p in tmp_path.iterdir()}
    rng = np.random.default_rng(7)
    refused = 0
    for trial in range(18):
        part = list(parts)[trial % len(parts)]
        content = bytearray(parts[part])
        for at in rng.integers(0, min(len(content), 3000), 6):
            content[at] = rng.integers(0, 256)
        part.write_bytes(content[: rng.integers(1, len(content))] if trial % 3 == 0 else content)
        refused += try_to_read(path) is not None
        part.write_bytes(parts[part])
    assert try_to_read(path) is None
    assert refused > 0


@pytest.mark.parametrize("name", ["a.tif.aux.xml", "a.hdr", "a.lbl"])
def test_a_pipe_beside_a_raster_is_refused(tmp_path, name):
    (tmp_path / "a.tif").write_bytes(bytes(4096))
    os.mkfifo(tmp_path / name)
    with fuzz.at_most(10.0), pytest.raises(InputError, match="the pipe or device"):
        load_terrain(tmp_path / "a.tif")


def test_a_pipe_that_a_label_names_is_refused(tmp_path):
    os.mkfifo(tmp_path / "pipe.img")
    (tmp_path / "a.lbl").write_text('PDS_VERSION_ID = PDS3\n^IMAGE = "pipe.img"\nEND\n')
    with fuzz.at_most(10.0), pytest.raises(InputError, match="the pipe or device"):
        load_terrain(tmp_path / "a.lbl")


def test_a_link_with_a_header_of_its_own_reads_no_other_file(tmp_path):
    """A header may declare any file to be a raster of bytes."""
    (tmp_path / "secret").mkdir()
    (tmp_path / "secret" / "text").write_bytes(b"secret words " * 8)
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "z.dat").symlink_to(tmp_path / "secret" / "text")
    (tmp_path / "in" / "z.hdr").write_text(
        "ENVI\nsamples = 10\nlines = 10\nbands = 1\nheader offset = 0\ndata type = 1\n"
        "interleave = bsq\nbyte order = 0\n"
    )
    with pytest.raises(InputError, match="Put all parts of a raster into one folder"):
        load_terrain(tmp_path / "in" / "z.dat", posting=1.0)
    (tmp_path / "in" / "z.dat").unlink()
    shutil.copy(tmp_path / "secret" / "text", tmp_path / "in" / "z.dat")
    (tmp_path / "links").mkdir()
    for part in ("z.dat", "z.hdr"):
        (tmp_path / "links" / part).symlink_to(tmp_path / "in" / part)
    assert load_terrain(tmp_path / "links" / "z.dat", posting=1.0).z.shape == (10, 10)

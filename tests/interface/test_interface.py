"""The interface: header and schema follow from the definitions, and their layouts agree."""

from __future__ import annotations

import ctypes
import socket
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import lunarsim
from lunarsim.cli import main
from lunarsim.interface.definitions import MESSAGES, ROLES
from lunarsim.interface.header import header, struct_name
from lunarsim.interface.protobuf import (
    SizeError,
    from_protobuf,
    new_message,
    schema_text,
    to_protobuf,
)
from lunarsim.interface.structs import Struct, dtype_of
from lunarsim.interface.wire import Channel, SharedArrays, WireError
from lunarsim.onboard.external.failure import SoftwareFailure
from tests.interface.software import compiler

FOLDER = Path(lunarsim.__file__).parent / "interface"
DOUBLES = ctypes.POINTER(ctypes.c_double)


def filled(name: str, rng: np.random.Generator) -> Struct:
    """Return a message with random values in every field, also in lists."""
    out = Struct(name)
    fill(out, rng)
    return out


def fill(out: Struct, rng: np.random.Generator) -> None:
    lists = {f.count for f in out.message.fields if f.is_list}
    for f in out.message.fields:
        if f.name in lists:
            continue
        if f.is_list:
            for part in out.resize_list(f.name, int(rng.integers(0, 4))):
                fill(part, rng)
        elif f.is_block:
            kind = {"double": np.float64, "float": np.float32, "uint8": np.uint8}[f.type]
            out.attach(**{f.name: rng.integers(0, 200, int(rng.integers(1, 50))).astype(kind)})
        elif f.is_message:
            parts = out.parts[f.name] if f.shape else [out.parts[f.name]]
            for part in parts:
                fill(part, rng)
        elif f.type == "text":
            out.set(**{f.name: b"text %d" % rng.integers(0, 1000)})
        elif f.type == "double":
            out.set(**{f.name: rng.standard_normal(f.shape)})
        else:
            out.set(**{f.name: int(rng.integers(0, 5))})
    if out.message.name == "Command":
        out.set(task_count=3)


def assert_equal(a: Struct, b: Struct) -> None:
    for f in a.message.fields:
        if f.is_list:
            assert len(a.parts[f.name]) == len(b.parts[f.name])
            for one, other in zip(a.parts[f.name], b.parts[f.name], strict=True):
                assert_equal(one, other)
        elif f.is_block:
            assert np.array_equal(a.arrays[f.name], b.arrays[f.name])
            assert a.arrays[f.name].dtype == b.arrays[f.name].dtype
        elif f.is_message:
            n = a.get("task_count") if f.shape else 1
            pairs = zip(*((s.parts[f.name] if f.shape else [s.parts[f.name]]) for s in (a, b)),
                        strict=True)  # fmt: skip
            for one, other in list(pairs)[:n]:
                assert_equal(one, other)
        else:
            assert np.array_equal(a.get(f.name), b.get(f.name)), f.name


def test_header_and_schema_are_those_of_the_definitions():
    assert (FOLDER / "lunarsim.h").read_text() == header()
    assert (FOLDER / "lunarsim.proto").read_text() == schema_text()
    for command, text in (("header", header()), ("proto", schema_text())):
        assert CliRunner().invoke(main, ["interface", command]).output == text


@pytest.mark.parametrize("language", ["gcc", "g++"])
def test_c_structures_have_the_offsets_of_the_messages(language, tmp_path):
    lines = [
        f'printf("{name}.{f.name} %zu\\n", offsetof({struct_name(name)}, {f.name}));'
        for name, message in MESSAGES.items()
        for f in message.fields
    ]
    suffix = "c" if language == "gcc" else "cpp"
    source = tmp_path / f"offsets.{suffix}"
    source.write_text(
        '#include "lunarsim.h"\n#include <stdio.h>\nint main(void) {' + "\n".join(lines)
        + "return 0; }"
    )  # fmt: skip
    standard = "-std=c11" if language == "gcc" else "-std=c++17"
    program = tmp_path / "offsets"
    subprocess.run(
        [compiler(language), standard, "-Wall", "-Wextra", "-Wpedantic", "-Werror", f"-I{FOLDER}",
         source, "-o", program], check=True,
    )  # fmt: skip
    found = dict(line.split() for line in subprocess.check_output(program, text=True).splitlines())
    wanted = {
        f"{name}.{f.name}": str(dtype_of(name).fields[f.name][1])
        for name, message in MESSAGES.items()
        for f in message.fields
    }
    assert found == wanted


@pytest.mark.parametrize("name", [r.input for r in ROLES.values()] + ["Briefing", "Command"])
def test_message_is_unchanged_by_protobuf_and_shared_memory(name, tmp_path):
    rng = np.random.default_rng(3)
    memory = SharedArrays(tmp_path / "arrays", is_owner=True)
    for _ in range(20):
        given, back = filled(name, rng), Struct(name)
        message = new_message(name)
        memory.clear()
        to_protobuf(given, message, memory)
        again = new_message(name)
        again.ParseFromString(message.SerializeToString())
        from_protobuf(again, back, memory)
        assert_equal(given, back)


def test_schema_for_protoc_describes_the_messages(tmp_path):
    protoc = pytest.importorskip("grpc_tools.protoc")
    from google.protobuf import descriptor_pb2

    out = tmp_path / "set.pb"
    code = protoc.main(
        ["protoc", f"-I{FOLDER}", f"--descriptor_set_out={out}", str(FOLDER / "lunarsim.proto")]
    )
    assert code == 0
    found = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes()).file[0]
    known = descriptor_pb2.FileDescriptorProto()
    new_message("Request").DESCRIPTOR.file.CopyToProto(known)
    assert {m.name for m in found.message_type} == {m.name for m in known.message_type}
    for message in found.message_type:
        (other,) = [m for m in known.message_type if m.name == message.name]
        a, b = (
            [(f.name, f.number, f.type, f.type_name, f.label) for f in m.field]
            for m in (message, other)
        )
        assert a == b


def test_shared_memory_grows_and_refuses_arrays_outside(tmp_path):
    writer = SharedArrays(tmp_path / "arrays", is_owner=True)
    reader = SharedArrays(tmp_path / "arrays", is_owner=False)
    small, large = np.arange(5.0), np.arange(1e6)
    places = writer.place(small), writer.place(large)
    for array, offset in zip((small, large), places, strict=True):
        assert np.array_equal(reader.view(offset, array.size, np.float64), array)
    with pytest.raises(WireError, match="does not lie"):
        reader.view(places[1], 10_000_000, np.float64)
    with pytest.raises(WireError, match="does not lie"):
        reader.view(3, 1, np.float64)


def in_memory(struct: Struct, name: str, size: int) -> np.ndarray:
    """Return what a C function reads at the pointer of an array of doubles."""
    return np.ctypeslib.as_array(ctypes.cast(int(struct.get(name)), DOUBLES), (size,)).copy()


def test_arrays_keep_their_values_while_their_sizes_change(tmp_path):
    """Small arrays are copied, large ones addressed; both reach C and a process."""
    rng = np.random.default_rng(1)
    memory = SharedArrays(tmp_path / "arrays", is_owner=True)
    reader = SharedArrays(tmp_path / "arrays", is_owner=False)
    given, back = Struct("Candidates"), Struct("Candidates")
    for count in (256, 257, 1, 256, 0, 86, 85, 300, 256, 2):
        position, distance = rng.standard_normal((count, 3)), rng.random(2 * count)[::2]
        value = rng.random(count).astype(np.float32)
        given.attach(position=position, distance=distance, value=value)
        memory.clear()
        message = new_message("Candidates")
        to_protobuf(given, message, memory)
        from_protobuf(message, back, reader)
        for struct in (given, back):
            for name, array in (("position", position), ("distance", distance), ("value", value)):
                if count:
                    assert np.array_equal(in_memory(struct, name, array.size), array.ravel())
                else:
                    assert struct.get(name) == 0  # NULL


def test_small_array_does_not_change_with_its_source():
    out, source = Struct("Candidates"), np.arange(4.0)
    for first in (0.0, 5.0):
        source[:] = first + np.arange(4.0)
        out.attach(value=source)
        source[:] = -1.0
        assert np.array_equal(in_memory(out, "value", 4), first + np.arange(4.0))


def test_text_ends_at_its_first_zero_byte():
    answer, message = Struct("PolicyOutput"), new_message("PolicyOutput")
    answer.set(reason=b"near\0rest of an older text")
    to_protobuf(answer, message, SharedArrays)
    assert answer.text("reason") == message.reason == "near"


def test_failure_has_a_printable_description():
    failure = SoftwareFailure("guidance", "error", "a\nb\0\x1b[31mc")
    assert str(failure) == "external guidance: error: a b  [31mc"


def test_fixed_arrays_of_a_program_may_be_absent_but_not_too_long():
    message, answer = new_message("Command"), Struct("Command")
    answer.set(attitude=(0.0, 0.0, 0.0, 1.0))
    from_protobuf(message, answer, SharedArrays)
    assert np.isnan(answer.get("attitude")).all()
    for _ in range(9):
        message.task.add()
    with pytest.raises(SizeError, match="at most 8"):
        from_protobuf(message, answer, SharedArrays)


def test_list_of_a_program_becomes_empty_again():
    given, message = Struct("Measurements"), new_message("Measurements")
    message.altimeter_reading.add().range = 5.0
    from_protobuf(message, given, SharedArrays)
    assert given.parts["altimeter_reading"][0].get("range") == 5.0
    from_protobuf(new_message("Measurements"), given, SharedArrays)
    assert given.get("altimeter_reading_count") == given.get("altimeter_reading") == 0


def test_messages_are_received_one_by_one_and_in_time():
    ours, theirs = socket.socketpair()
    sender, receiver, message = Channel(theirs), Channel(ours), new_message("Reply")
    for error in ("first", "second"):
        message.error = error
        sender.send(message)
    for error in ("first", "second"):
        receiver.receive(message, time.monotonic() + 5.0)
        assert message.error == error
    # The deadline also ends a message that arrives slowly.
    theirs.sendall(b"\x10\0")
    start = time.monotonic()
    for deadline in (start + 0.05, start - 1.0):
        with pytest.raises(TimeoutError):
            receiver.receive(message, deadline)
    assert time.monotonic() - start < 5.0
    theirs.close()
    with pytest.raises(WireError, match="closed"):
        receiver.receive(message)

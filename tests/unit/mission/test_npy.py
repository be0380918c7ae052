"""A file in NumPy's format whose header was written by hand is refused in one line, and takes no memory."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from he3.errors import InvalidInput
from services.mission.covariates import covariates
from services.mission.npy import mapped_array
from services.mission.regions import load_region

HEADERS = {
    "more cells than memory": "{'descr': '<f8', 'fortran_order': False, 'shape': (10000000, 10000000)}",
    "more cells than a number holds": "{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999999999999, 2)}",
    "brackets without end": "[" * 9000,
    "signs without end": "-" * 9000 + "1",
    "a text without end": "{'''",
    "keys of several types": "{1: 2, 'descr': '<f8', 'fortran_order': False, 'shape': (1,)}",
    "a shape that is no number": "{'descr': '<f8', 'fortran_order': False, 'shape': (True, 2)}",
}


def array_file(header: str) -> bytes:
    """An .npy file with that header and eight numbers."""
    text = header.encode() + b"\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(64)


@pytest.mark.parametrize("content", [*map(array_file, HEADERS.values()), b""], ids=[*HEADERS, "nothing"])
def test_a_header_that_no_array_has_is_refused_in_one_line(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "layer.npy").write_bytes(content)
    with pytest.raises(InvalidInput) as refusal:
        mapped_array(tmp_path / "layer.npy")
    assert str(refusal.value)
    with pytest.raises(InvalidInput, match=r"covariate \S+layer.npy: expected an array that NumPy reads, got ."):
        covariates([str(tmp_path / "layer.npy")], load_region("t1"))
    with zipfile.ZipFile(tmp_path / "region.npz", "w") as archive:
        archive.writestr("he3_ppb.npy", content)
    with pytest.raises(InvalidInput, match=r"region\.npz: (expected an \.npz file of plain|key he3_ppb: expected)"):
        load_region(tmp_path / "region.npz")


def test_an_archive_under_the_name_of_an_array_is_none(tmp_path: Path) -> None:
    np.savez(tmp_path / "two.npz", a=np.zeros(3))
    (tmp_path / "two.npz").rename(tmp_path / "layer.npy")
    with pytest.raises(InvalidInput, match=r"covariate \S+layer.npy: expected an array that NumPy reads, got an .npz"):
        covariates([str(tmp_path / "layer.npy")], load_region("t1"))


def test_an_array_is_read_as_it_was_saved(tmp_path: Path) -> None:
    values = np.random.default_rng(3).normal(size=(4, 5))
    np.save(tmp_path / "layer.npy", values)
    np.testing.assert_array_equal(mapped_array(tmp_path / "layer.npy"), values)

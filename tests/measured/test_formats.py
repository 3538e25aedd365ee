"""Every format gives back the samples that went in, bit by bit, and says clearly what it cannot
read.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.errors import InputError, MissingExtra
from hiltestbed.measured import apart, examine, load_dataset
from hiltestbed.measured import columns as columns_module
from hiltestbed.measured.formats import format_of, read_columns
from tests.measured.data_files import WRITERS

from . import bounce

# asammdf's destructor stumbles over a file that its constructor has refused
pytestmark = pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("name", WRITERS)
def test_samples_come_back_as_they_went_in(tmp_path: Path, name: str) -> None:
    table = bounce.columns()
    WRITERS[name](tmp_path / name, table)
    dataset = load_dataset(bounce.write_dataset(tmp_path, files=(name,)))
    record = dataset.runs[0].record
    assert not dataset.remarks
    np.testing.assert_array_equal(record.t, table["t"])
    assert set(record.columns()) == set(table) - {"t"}
    for column in record.columns():
        np.testing.assert_array_equal(record.column(column), table[column], err_msg=column)
        assert record.measured(column).all()


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize("name", ["run.csv", "run.parquet", "run.h5", "run.mf4", "run.tdms"])
def test_the_unit_that_a_file_states_is_converted(tmp_path: Path, name: str) -> None:
    """Torques in N mm, one table of units for every format."""
    table = bounce.columns()
    units = {n: "N·mm" for n in table if n[:-1].endswith(".t")}
    in_mm = {n: 1e3 * values if n in units else values for n, values in table.items()}
    WRITERS[name](tmp_path / name, in_mm, units)
    dataset = examine(bounce.write_dataset(tmp_path, files=(name,)))
    found = dataset.runs[0].record.column("wrench_meas.tx")
    np.testing.assert_allclose(found, table["wrench_meas.tx"], rtol=1e-9)
    assert any("multiplied by 0.001" in remark.text for remark in dataset.remarks)


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_that_was_cut_short_is_refused(tmp_path: Path, name: str) -> None:
    """Half a file, any bytes under the suffix, or none: an error that names the file, never a
    traceback of the library.
    """
    WRITERS[name](tmp_path / name, bounce.columns())
    whole = (tmp_path / name).read_bytes()
    cut = b"\x00\xff" * 400 if name.endswith("csv") else whole[: len(whole) // 2]
    for content, said in ((cut, name.replace(".", r"\.")), (b"", "is empty")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=said):
            load_dataset(bounce.write_dataset(tmp_path, files=(name,)))


@pytest.mark.parametrize(
    ("suffix", "module", "extra"),
    [
        ("h5", "h5py", "hdf5"),
        ("mf4", "asammdf", "mdf"),
        ("tdms", "nptdms", "tdms"),
        ("mcap", "mcap.reader", "mcap"),
    ],
)
def test_a_missing_reader_is_an_install_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str, module: str, extra: str
) -> None:
    path = tmp_path / f"run.{suffix}"
    path.write_bytes(b"anything")
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(MissingExtra, match=rf"pip install .hiltestbed\[{extra}\]"):
        format_of(path).read(path, frozenset({"t"}))


CRASH = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
HANG = "import time; time.sleep(60)"
FILL = "x = bytearray(1 << 44)"


@pytest.mark.parametrize(
    ("what", "said"),
    [
        (CRASH, "crashes its reader \\(signal 11\\)"),
        (HANG, "is not read within 3 s"),
        (FILL, "more memory than"),
    ],
)
def test_a_reader_that_fails_takes_nothing_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, said: str
) -> None:
    """A parser of foreign formats that crashes, hangs or believes any size, in place of the one
    that is installed.
    """
    (tmp_path / "h5py").mkdir()
    (tmp_path / "h5py" / "__init__.py").write_text(what)
    (tmp_path / "run.h5").write_bytes(b"anything")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(apart, "TIME_LIMIT", 3.0 if what == HANG else 60.0)
    with pytest.raises(InputError, match=rf"run\.h5: .*{said}"):
        read_columns(tmp_path / "run.h5", frozenset({"t"}))


def test_unknown_suffix_names_the_known_ones(tmp_path: Path) -> None:
    (tmp_path / "run.xlsx").write_bytes(b"PK")
    with pytest.raises(InputError, match=r"\.csv.*\.mcap"):
        load_dataset(bounce.write_dataset(tmp_path, files=("run.xlsx",)))


def test_a_large_csv_is_refused_before_it_is_read(tmp_path: Path) -> None:
    """2 GB of which the file system holds a few blocks: the estimate of its rows from the first of
    them is enough.
    """
    path = tmp_path / "run.csv"
    WRITERS["run.csv"](path, bounce.columns(rate=10_000.0))
    assert path.stat().st_size > 2e6
    with path.open("r+b") as file:
        file.truncate(2_000_000_000)
    with pytest.raises(InputError, match=r"too large.*allowed are"):
        load_dataset(bounce.write_dataset(tmp_path, files=("run.csv",)))


def test_a_csv_is_streamed_for_its_mapped_columns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Twenty columns that nobody asked for count neither in memory nor against the limit."""
    table = bounce.columns() | {f"temperature {i}": np.arange(600.0) for i in range(20)}
    WRITERS["run.csv"](tmp_path / "run.csv", table)
    monkeypatch.setattr(columns_module, "SAMPLE_LIMIT", 3 * 600 + 300)
    found = read_columns(tmp_path / "run.csv", frozenset({"t", "pose_act.pz", "wrench_meas.fz"}))
    assert set(found.data) == {"t", "pose_act.pz", "wrench_meas.fz"}
    assert "temperature 7" in found.names


@pytest.mark.parametrize(
    ("units", "stated"), [("s;N;m", "s"), ("[ms];[kN];[mm]", "ms"), ("(s);(lbf);(m)", "s")]
)
def test_a_row_of_units_below_the_names_gives_the_units(
    tmp_path: Path, units: str, stated: str
) -> None:
    """No row is lost, and no number is changed by the reader."""
    (tmp_path / "run.csv").write_text(f"# logger\nt;F z;x\n{units}\n0;1;2\n1;2;3\n")
    found = read_columns(tmp_path / "run.csv", frozenset({"t", "F z"}))
    assert found.data["F z"].tolist() == [1.0, 2.0]
    assert found.units["t"] == stated

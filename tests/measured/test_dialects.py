"""A text table gives its samples back however it was written; what cannot be told apart is refused
with what the file is and the key that reads it.
"""

from __future__ import annotations

from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from hiltestbed.errors import InputError
from hiltestbed.measured.formats import read_columns
from hiltestbed.measured.formats.text import Text

NAMES = ("t", "pose_act.pz", "wrench_meas.fz")
ROWS = np.column_stack(
    [np.arange(500) / 250.0, np.linspace(-3e-3, 2e-3, 500), 1.5 * np.sin(np.arange(500.0))]
)
ROWS[0] = 0.0  # a first row that tells nothing of the decimal sign


def written(
    delimiter: str = ",", decimal: str = ".", head: str = "", above: str = "", form: str = ".9g"
) -> str:
    """The table as text: lines ``above``, the names or ``head``, the rows."""
    rows = [delimiter.join(format(v, form).replace(".", decimal) for v in row) for row in ROWS]
    return above + "\n".join([head or delimiter.join(NAMES), *rows]) + "\n"


TABLES: dict[str, str | bytes] = {
    "tabs and decimal commas": written("\t", ","),
    "semicolons, decimal commas, names in line 3": written(";", ",", above="Rig A\nrun, 7\n"),
    "preamble with a blank line": written(above="Bench: 3\nRate: 250 Hz\n\n"),
    "bars": written("|"),
    "padded bars": written(" | "),
    "blanks, several and leading": "  " + written("   ").replace("\n", "\n   "),
    "blanks after commas": written(", "),
    "blanks around the names": written(head=" t , pose_act.pz , wrench_meas.fz "),
    "sep= of a spreadsheet": written(";", ",", above="sep=;\n"),
    "names behind #": written(head="# " + ",".join(NAMES)),
    "names behind % after a comment": written(" ", head="% " + " ".join(NAMES), above="% run 3\n"),
    "exponents of Fortran": written(form=".12E").replace("E", "D"),
    "exponents of Fortran, blanks": written(" ", form=".12E").replace("E", "d"),
    "UTF-16": written("\t").encode("utf-16"),
    "UTF-16 without a mark": written("\t", ",").encode("utf-16-be"),
    "UTF-8 with a mark": written().encode("utf-8-sig"),
    "Latin-1": written(";", ",", above="Prüfstand\n").encode("latin-1"),
    "old line ends": written().replace("\n", "\r"),
    "delimiters at the ends of rows": written().replace("\n", ",\n"),
    "names of columns without samples": written(head=",".join(NAMES) + ",Comment"),
    "a comment between rows": written().replace("\n0.4,", "\n# pressed stop\n0.4,"),
    "a note of the units behind the names": written(head="t, pose_act.pz ,wrench_meas.fz (N)"),
    "a clock with commas beside points": "\n".join(
        f"{'clock' if k == 0 else f'12:00:00,{k:03d}'};{line}"
        for k, line in enumerate(written(";").splitlines())
    ),
}


@pytest.mark.parametrize("how", TABLES)
def test_a_table_is_read_however_it_was_written(tmp_path: Path, how: str) -> None:
    text = TABLES[how]
    path = tmp_path / "run.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    found = read_columns(path, frozenset(NAMES))
    for k, name in enumerate(NAMES):
        np.testing.assert_allclose(found.data[name], ROWS[:, k], rtol=1e-8, err_msg=name)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ("UTF-16", ("tabs", "line 1", "utf-16")),
        ("tabs and decimal commas", ("tabs", "decimal commas")),
        ("preamble with a blank line", ("line 4",)),
    ],
)
def test_what_was_recognised_is_said(tmp_path: Path, how: str, said: tuple[str, ...]) -> None:
    text = TABLES[how]
    (tmp_path / "run.csv").write_bytes(text if isinstance(text, bytes) else text.encode())
    (note,) = read_columns(tmp_path / "run.csv", frozenset(NAMES)).notes
    assert all(word in note for word in said)


def test_commas_that_separate_and_are_decimal_signs_cannot_be_told_apart(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(written(",", ","))
    with pytest.raises(InputError, match=r"another sign than commas.*format: \{kind: text"):
        read_columns(tmp_path / "run.csv", frozenset(NAMES))


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(",", "."), (";", ","), (" ", "."), ("\t", ",")]
)
def test_columns_without_names_are_numbered(tmp_path: Path, delimiter: str, decimal: str) -> None:
    """No row is taken for the names; numbers above the rows are names."""
    bare = written(delimiter, decimal).partition("\n")[2]
    for text, name in ((bare, "3"), (f"{delimiter.join('012')}\n{bare}", "2")):
        (tmp_path / "run.csv").write_text(text)
        found = read_columns(tmp_path / "run.csv", frozenset({name}))
        np.testing.assert_allclose(found.data[name], ROWS[:, 2], rtol=1e-8)
    (tmp_path / "run.csv").write_text(bare)
    (note,) = read_columns(tmp_path / "run.csv", frozenset(NAMES)).notes
    assert "without names: the columns are 1, 2, ..." in note


def test_a_text_in_place_of_a_number_is_named_with_the_key_that_reads_it(tmp_path: Path) -> None:
    """The message proposes the mark; with it the sample is missing and every row is still there."""
    (tmp_path / "run.csv").write_text(written(";").replace("\n0.4;", "\nOVL;"))
    with pytest.raises(InputError, match=r"'t' \(got 'OVL' in row 101.*marks: \['OVL'\]"):
        read_columns(tmp_path / "run.csv", frozenset(NAMES))
    t = read_columns(tmp_path / "run.csv", frozenset(NAMES), Text(marks=("OVL",))).data["t"]
    assert np.flatnonzero(np.isnan(t)).tolist() == [100]
    assert len(t) == len(ROWS)


BEGIN = datetime(2024, 2, 28, 23, 59, 30, 250000)
STAMPS = {
    "ISO 8601": "%Y-%m-%dT%H:%M:%S.250Z",
    "a database": "%Y/%m/%d %H:%M:%S.25",
    "a spreadsheet in Germany": "%d.%m.%Y %H:%M:%S,25",
    "a spreadsheet in the USA": "%m/%d/%Y %I:%M:%S.25 %p",
}


@pytest.mark.parametrize("how", STAMPS)
def test_dates_and_times_are_seconds(tmp_path: Path, how: str) -> None:
    """Rows a second apart, across midnight into a leap day, whatever the way of writing."""
    lines = [f"{BEGIN + timedelta(seconds=k):{STAMPS[how]}};{k}" for k in range(90)]
    (tmp_path / "run.csv").write_text("t;wrench_meas.fz\n" + "\n".join(lines))
    t = read_columns(tmp_path / "run.csv", frozenset(NAMES)).data["t"]
    np.testing.assert_allclose(np.diff(t), 1.0, atol=1e-9)

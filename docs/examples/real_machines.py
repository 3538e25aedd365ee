"""The pages of the real machines, and the table of docs/real-machines.md, from the output of the
benchmark.

    hiltestbed bench real --data DIR --figures --out results/real
    python docs/examples/real_machines.py results/real

Writes docs/real-machines/*.md, its pictures, and what stands between the marks in
docs/real-machines.md.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from PIL import Image

DOCS = Path(__file__).resolve().parents[1]
OVERVIEW, PAGES = DOCS / "real-machines.md", DOCS / "real-machines"
WIDTH, COLOURS = 760, 48  # [px], of a picture: no more than 40 kB with them
AS_GOOD, NEAR = 1.05, 1.3  # times the expert's residual
NAMES = {  # folder of the records, to the name of its page
    "emps": "A carriage on a ball screw (EMPS)",
    "ur10e": "Joints of a robot arm (UR10e)",
    "hsm150": "A two-motor drive (HSM150)",
    "so101_servo": "A hobby servo arm (SO-101)",
    "sts3215": "Hobby servos on a test stand (STS3215)",
    "camber": "Camber and toe actuators of a wheel",
    "press": "A servo-hydraulic press",
    "friction_damper": "A friction damper with play",
    "mr_damper": "A magnetorheological damper",
    "dyno_damper": "A hydraulic damper on a dynamometer",
}
Record = Mapping[str, Any]


def main(bench: Path) -> None:
    """Write the pages from a folder of the benchmark."""
    found = json.loads((bench / "bench.json").read_text(encoding="utf-8"))
    records = found["records"]
    if "quick" in found["options"] or found["summary"]["skipped"]:
        sys.exit(f"{bench}: lacks machines; give the output of a run with the records of all")
    PAGES.mkdir(exist_ok=True)
    for old in (*PAGES.glob("*.md"), *PAGES.glob("*.png")):
        old.unlink()
    groups: dict[str, list[Record]] = {}
    for number, record in enumerate(records, 1):
        (figure,) = (bench / "figures").glob(f"{number:02d}-*.png")
        picture(figure, PAGES / f"{record['device']}.png")
        groups.setdefault(record["files"][0].split("/")[0], []).append(record)
    for group, own in groups.items():
        (PAGES / f"{group}.md").write_text(page(NAMES[group], own), encoding="utf-8")
    text = OVERVIEW.read_text(encoding="utf-8")
    for mark, new in (
        ("summary", summary(records, found["summary"])),
        ("table", overview(groups)),
        ("sources", sources(groups)),
    ):
        marks = f"<!-- {mark} -->", f"<!-- end of {mark} -->"
        text, count = re.subn(f"{marks[0]}.*{marks[1]}", f"\n{new}\n".join(marks), text, flags=re.S)
        assert count == 1, mark
    OVERVIEW.write_text(text, encoding="utf-8")


def picture(source: Path, target: Path) -> None:
    """A figure with fewer pixels and colours."""
    with Image.open(source) as opened:
        image = opened.convert("RGB")
    small = image.resize((WIDTH, image.height * WIDTH // image.width), Image.Resampling.LANCZOS)
    small.quantize(COLOURS, Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE).save(
        target, optimize=True
    )


def page(name: str, records: Iterable[Record]) -> str:
    """The page of machines that are alike."""
    lines = [
        f"# {name}",
        "",
        "Each picture shows a record that was not fitted: measured, as the nominal model, the "
        "expert's and the diagnosis predict it, and below what each leaves. All numbers are made "
        "by `hiltestbed bench real --data DIR --figures --out results/real` and `python "
        "docs/examples/real_machines.py results/real`; how, and for the other machines, see "
        "[real machines](../real-machines.md).",
    ]
    for r in records:
        lines += ["", *machine(r)]
    return "\n".join(lines) + "\n"


def machine(r: Record) -> Iterable[str]:
    """What stands on a page of one machine."""
    yield from (f"## `{r['device']}`: {r['title']}", "", f"![{r['title']}]({r['device']}.png)", "")
    yield from (f"**`{r['verdict']}`.** {r['sentence']}", "")
    names = [n for n in ("constant", "nominal", "expert", "peer", "product") if n in r]
    unit = r["unit"]
    yield f"| left out | {' | '.join(f'{n} [{unit}]' for n in names[:-1])} | diagnosis [{unit}] |"
    yield "|---" * (1 + len(names)) + "|"
    for run in r["left_out"]["constant"]:
        yield row(run, [r["left_out"][n][run] for n in names])
    if len(r["left_out"]["constant"]) > 1:
        yield row("geometric mean", [r[n] for n in names])
    yield from (
        "",
        f"Fitted: {', '.join(r['fitted'])}. {r['ratio']:.2f} times the expert's residual, "
        f"{r['cpu']:.0f} s of processor time (`hiltestbed bench real`).",
        "",
    )
    if r["parameters"]:
        yield "| effect | parameter | estimate | 95 % interval | published | removes | as likely |"
        yield "|---|---|---|---|---|---|---|"
    for cause in (*r["parameters"], *r["undetermined"]):
        open_ = "" if cause in r["parameters"] else ", not determined"
        for parameter, p in cause["parameters"].items():
            ends = "" if p["ci95"] is None else "{:.4g} to {:.4g}".format(*p["ci95"])
            rivals = ", ".join(f"`{x}`" for x in cause["indistinguishable_from"])
            yield (
                f"| `{cause['effect']}`{open_} | {parameter} | {p['estimate']:.4g} "
                f"{'' if p['unit'] == '-' else p['unit']} | {ends} | "
                f"{published(r, cause['effect'], parameter, p['ci95'])} | "
                f"{100.0 * cause['gain']:.0f} % | {rivals} |"
            )
    named = {p for c in (*r["parameters"], *r["undetermined"]) for p in c["parameters"]}
    believed = r["nominal_numbers"].items()
    others = {k: v for k, v in r["published"].items() if k not in named and (k, v) not in believed}
    if others:
        yield (
            "\nPublished, and no parameter of a cause: "
            + ", ".join(f"{k} {v:.4g}" for k, v in others.items())
            + "."
        )
    yield from ("", f"Source: {r['source']}. Licence: {r['licence']}.")


def row(name: str, values: Iterable[float]) -> str:
    """A row of a table of numbers."""
    return f"| {name} | {' | '.join(f'{v:.3g}' for v in values)} |"


def published(r: Record, effect: str, parameter: str, ends: Any) -> str:
    """The value that the source states, and whether it is in the interval."""
    known, nominal = r["published"], r["nominal_numbers"]
    if parameter == "factor":
        name = effect.removeprefix("dynamics.")
        value = known[name] / nominal[name] if name in known and name in nominal else None
    else:
        value = known.get(parameter) if effect == "dynamics.force" else None
    if value is None:
        return ""
    inside = ends is not None and ends[0] <= value <= ends[1]
    return f"{value:.4g}, {'inside' if inside else 'outside'}"


def summary(records: list[Record], s: Mapping[str, float]) -> str:
    """The result in two sentences."""
    good, near = (sum(r["ratio"] <= most for r in records) for most in (AS_GOOD, NEAR))
    return (
        f"**{good} of {len(records)} are as good as the expert's (within 5 %), {near} within 30 %; "
        f"the median ratio is {s['median_ratio']:.2f}, the worst {s['worst_ratio']:.2f}.** A "
        f"diagnosis takes {s['median_cpu']:.0f} s of\nprocessor time in the median and "
        f"{s['longest_cpu']:.0f} s at most."
    )


def overview(groups: Mapping[str, list[Record]]) -> str:
    """The table of all machines."""
    lines = [
        "| machine | what it is | nominal | expert | diagnosis | ratio | verdict | causes |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for group, own in groups.items():
        for r in own:
            causes = ", ".join(f"`{c}`" for c in dict.fromkeys(r["causes"]))
            lines.append(
                f"| [`{r['device']}`](real-machines/{group}.md) | {r['title']} | "
                f"{r['nominal']:.3g} {r['unit']} | {r['expert']:.3g} | {r['product']:.3g} | "
                f"{r['ratio']:.2f} | `{r['verdict']}` | {causes} |"
            )
    return "\n".join(lines)


def sources(groups: Mapping[str, list[Record]]) -> str:
    """The table of the sources."""
    rows: dict[tuple[str, str], list[str]] = {}
    for r in (r for own in groups.values() for r in own):
        where = r["source"].replace("github:", "GitHub, ")
        rows.setdefault((where, r["licence"]), []).append(f"`{r['device']}`")
    lines = ["| machines | source | licence |", "|---|---|---|"]
    lines += [f"| {', '.join(m)} | {s} | {licence} |" for (s, licence), m in rows.items()]
    return "\n".join(lines)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

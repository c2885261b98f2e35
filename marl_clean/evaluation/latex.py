r"""`tables.tex`: the tables of a comparison for a paper, with booktabs and 95 % intervals."""

from collections.abc import Mapping, Sequence
from typing import Any

from marl_clean.evaluation.gains import gain_cells
from marl_clean.evaluation.records import SHOWN_EXTERNAL
from marl_clean.evaluation.row_statistics import SCORE, TIMES

SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    **{character: f"\\{character}" for character in "&%$#_{}"},
}


def to_latex(worlds: Sequence[Sequence[Mapping[str, Any]]]) -> str:
    """A table for each world's statistics (`row_statistics`); needs \\usepackage{booktabs}."""
    return "% needs \\usepackage{booktabs}\n" + "\n".join(_table(rows) for rows in worlds)


def escaped(text: str) -> str:
    """A text that LaTeX prints as it stands."""
    return "".join(SPECIAL.get(character, character) for character in text)


def _table(rows: Sequence[Mapping[str, Any]]) -> str:
    first = rows[0]
    timed = "T_100" in first["aggregates"]
    measures = TIMES if timed else SHOWN_EXTERNAL
    over = next((row["improvement"]["over"] for row in rows if "improvement" in row), None)
    heads = ["policy", "seeds"]
    heads += [head for name in measures for head in (escaped(name), f"IQM {escaped(name)}")]
    heads += ["optimality gap"] if timed else []
    heads += [f"P({'sooner' if timed else 'more'})"] if over is not None else []
    gain_heads, *gains = gain_cells(rows)
    heads += map(escaped, gain_heads)
    lines = [_line(heads), r"\midrule"]
    for row, gained in zip(rows, gains, strict=True):
        shown = row["aggregates"]
        cells = [escaped(row["row"]), str(len(row["seeds"])) if row["seeds"] else "--"]
        cells += [_cell(shown[name][kind]) for name in measures for kind in ("mean", "iqm")]
        cells += [_cell(shown[SCORE]["optimality_gap"], 2)] if timed else []
        if over is not None:
            cells.append(_cell(row.get("improvement", {}).get(measures[-1]), 2))
        lines.append(_line([*cells, *map(escaped, gained)]))
    note = f"{first['houses']} houses ({first['house_set']}), {first['n_agents']} robots."
    note += " Brackets: 95 % intervals."
    note += "" if over is None else f" P against {over}."
    return "\n".join(
        [
            r"\begin{table}",
            r"\centering",
            rf"\caption{{{escaped(note)}}}",
            rf"\begin{{tabular}}{{l{'r' * (len(heads) - 1)}}}",
            r"\toprule",
            *lines,
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table}",
            "",
        ]
    )


def _line(cells: Sequence[str]) -> str:
    return " & ".join(cells) + r" \\"


def _cell(number: Mapping[str, Any] | None, digits: int = 1) -> str:
    if number is None or number["value"] is None:
        return "--"
    low, high = (f"{end:.{digits}f}" for end in number["ci95"])
    return f"{number['value']:.{digits}f} {{\\small [{low}, {high}]}}"

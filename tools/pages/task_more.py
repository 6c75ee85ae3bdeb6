"""Results beside the blind set of the task suite: what others make of its cases, harm looked at again, and what the named experiment settles."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from pages.markdown import table


def others(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.chain.others`."""
    methods = data["figures"]
    share = "held-out motion: share of what the true effects remove"
    headline = f"{len(data['rows'])} of {data['drawn']} cases: " + ", ".join(
        f"{name} removes {told[share]['value']:.2f} of {told[share]['of']}"
        for name, told in methods.items()
        if share in told
    )
    rows = (
        (name, figure, one["value"], "{:.2f} to {:.2f}".format(*one["ci95"]), one["of"])
        for name, told in methods.items()
        for figure, one in told.items()
    )
    body = table(("baseline", "figure", "share", "95 %", "of"), rows)
    head = ("case", "what is other", "baseline", "names", "as believed, px", "with it", "with all that is true")
    return headline, body + "\n## Every case\n\n" + table(head, _asked(data["rows"]))


def _asked(rows: Iterable[Mapping]) -> Iterable[tuple]:
    for row in rows:
        for name, told in row.get("methods", {}).items():
            motion = told.get("motion", {})
            names = told.get("error", "").strip().splitlines()[-1:] or (
                told["named"] if told["named"] is not None else ["never"]
            )
            yield (
                row["case"],
                _gap(row),
                name,
                ", ".join(names) or "nothing",
                *(motion.get(one) for one in ("believed", "after", "truth")),
            )


def harm(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.chain.harm`."""
    told = [(row, row["told"]) for row in data["rows"] if "told" in row]
    worse = [row["case"] for row, one in told if one["patch_removes"][2] < 0]
    headline = f"{len(worse)} of {len(told)} patches surely make the motion worse, of more windows"
    head = (
        "case",
        "what is other",
        "windows",
        "as believed, px",
        "with what was named",
        "removed",
        "with all that is true",
        "removed",
    )
    return headline, table(head, ((row["case"], _gap(row), *_shares(one)) for row, one in told))


def _shares(one: Mapping) -> tuple:
    patch, truth = ("{:.2f}, {:.2f} to {:.2f}".format(*one[f"{name}_removes"]) for name in ("patch", "truth"))
    return one["windows"], one["believed"], one["patch"], patch, one["truth"], truth


def put_down(data: Mapping) -> tuple[str, str]:
    """Headline and body of `np_blind.chain.put_down`."""
    settled = data["figures"]["settled by the named experiment"]
    headline = "settled {:.2f} of {}".format(settled["value"], settled["of"])
    rows = (
        (row["case"], _gap(row), row["verdict"].replace("_", " "), _named(row), "yes" if row["settled"] else "no")
        for row in data["rows"]
    )
    return headline, table(("case", "what is other", "verdict", "said", "settled"), rows)


def _named(row: Mapping) -> str:
    sizes = (
        "; ".join(f"{n} {v:.3g} ({low:.3g} to {high:.3g})" for n, (v, low, high) in of.items())
        for of in row["sizes"].values()
    )
    return "; ".join(f"{' or '.join(ids)}: {said}" for ids, said in zip(row["named"], sizes))


def _gap(row: Mapping) -> str:
    return (
        "; ".join(f"{e}: " + ", ".join(f"{n} {v:.3g}" for n, v in of.items()) for e, of in row["gap"].items())
        or row["kind"]
    )

"""Results of how fast things are: the bench of the graph, the trainer's throughput."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from pages.markdown import table


def _flat(data: Mapping, prefix: str = "") -> Iterator[tuple[str, object]]:
    for key, value in data.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{key}: ")
        else:
            yield f"{prefix}{key}".replace("_", " "), value


def bench(data: Mapping) -> tuple[str, str]:
    """Headline and body of `make bench`: every figure, peers beside."""
    trip = data["round_trip"]
    headline = (
        f"lockstep {data['lockstep']['factor']:g} of real time; round trip p50 {trip['p50_ms']:.2f} ms, "
        f"p99 {trip['p99_ms']:.2f} ms, {100 * trip['missed']:.2g} % late; detector {data['detector']['p50_ms']:.1f} ms"
    )
    body = ""
    for name, part in data.items():
        if name == "static":  # the bench measures it too, but it is no matter of speed
            body += "Contacts beside rigid theory, in the same data: [their page](static_bench.md).\n\n"
        elif isinstance(part, Mapping):
            body += f"## {name.replace('_', ' ').capitalize()}\n\n" + table(("figure", "value"), _flat(part)) + "\n"
    return headline, body.rstrip() + "\n"


def throughput(data: Mapping) -> tuple[str, str]:
    """Headline and body of the trainer against bare physics."""
    rows = [
        (text, data[key]["steps_per_second"] / 1e6, data[key]["contacts"])
        for text, key in (
            ("whole trainer", "trainer"),
            ("rollouts without update", "environment"),
            ("physics alone, in the same states", "bare_contact"),
            ("physics alone, arm free, object at rest", "bare_free"),
        )
    ]
    share = data["trainer_over_bare_contact"]
    free = data["trainer"]["steps_per_second"] / data["bare_free"]["steps_per_second"]
    body = table(("physics steps a second", "million", "contacts a world"), rows)
    body += f"\nTrainer over physics alone in the same states: {share:.2f}; over the bare scene, arm free and object at rest: {free:.2f}. A period's parts:\n\n"
    body += table(("part", "ms"), data["parts_ms"].items())
    return f"{data['trainer']['steps_per_second'] / 1e6:.1f} M physics steps/s, {share:.2f} of bare physics", body

"""Results of what a graph stands: many episodes, and messages that nobody should send."""

from __future__ import annotations

from collections.abc import Mapping

from pages.markdown import table


def soak(data: Mapping) -> tuple[str, str]:
    """Headline and body of `make soak`: every node's memory, handles and threads."""
    nodes, warm = data["nodes"], data["warm_up"]
    rows = [
        (
            name,
            *(f"{kB / 1e3:.1f}" for kB in one["memory"]),
            one["memory_per_episode"],
            *one["handles"],
            *one["threads"],
        )
        for name, one in nodes.items()
    ]
    fastest = max(one["memory_per_episode"] for one in nodes.values())
    verdict = f"growing: {', '.join(data['growing'])}" if data["growing"] else "all flat"
    ends = ", ".join(f"{count} {phase}" for phase, count in data["ends"].items())
    mode = "in real time" if data["arguments"].get("mode") == "realtime" else "in lockstep"
    columns = ("node", "MB first", "MB last", "kB an episode", "handles", "last", "threads", "last")
    body = (
        f"{data['episodes']} episodes ({ends}) in {data['wall_s']:.0f} s, {mode}, keypoints {data['arguments']['keypoints']}, seed "
        f"{data['arguments']['seed']}, revision {data['revision']}.\nThe first {warm} are left out; first and last are medians of a "
        f"tenth of the rest each.\nAllowed: {data['allowed_kB_per_episode']:g} kB an episode, and no handle or thread more.\n\n"
    )
    if data.get("stops"):
        body += f"The backend stopped {data['stops']} times, since commands stayed away, and was recovered.\n\n"
    if data["error"]:
        body += f"It ended early: {data['error']}.\n\n"
    return f"{data['episodes']} episodes, {verdict}, at most {fastest:g} kB an episode", body + table(columns, rows)


def fuzz(data: Mapping) -> tuple[str, str]:
    """Headline and body of `make fuzz`: by topic, what was sent and who refused how much."""
    died, silent = ", ".join(data["died"]) or "none", ", ".join(data["silent"]) or "none"
    rows = [
        (
            one["topic"],
            *(one["sent"].get(way, 0) for way in ("random", "broken", "bytes")),
            ", ".join(f"{name} {count}" for name, count in one["refused"].items()),
            ", ".join([*one["died"], *one["silent"]]),
        )
        for one in data["by_topic"]
    ]
    body = (
        f"{data['messages']} messages on {data['topics']} topics to {len(data['nodes'])} nodes in {data['wall_s']:.0f} s, seed "
        f"{data['seed']}, revision {data['revision']}.\nDied: {died}. Fell silent: {silent}.\n\n"
        "Random: every field of the right type and no sense. Broken: a real message with one to three fields random.\n"
        "Bytes: a serialized one cut off or changed; what the middleware cannot read it drops, and no node sees it.\n"
        "Refused counts what the node named and counted; what is harmless is not refused, and a recorder keeps what comes.\n\n"
    )
    headline = f"{data['messages']} messages: died {died}, silent {silent}, {data['refused']} refused by name"
    return headline, body + table(("topic", "random", "broken", "bytes", "refused by", "died or silent"), rows)

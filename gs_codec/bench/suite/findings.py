"""What the plots show, in a sentence each: their titles."""

from __future__ import annotations

from gs_codec.bench.suite.looks import Look, plain
from gs_codec.bench.suite.plot_costs import DECODING
from gs_codec.bench.suite.results import CURVES, Line, Results, finite
from gs_codec.bench.suite.tables import equal_rows, front_of


def equal_finding(results: Results, scene: str) -> str:
    """By how much ours is smaller than the others at their quality."""
    told = []
    for curve in CURVES:
        pairs = [(row, row.ours[curve]) for row in equal_rows(results, scene)]
        changes = [there.change(row.bits) for row, there in pairs if there is not None]
        if changes:
            told.append(f"{_span(min(changes), max(changes))} bits {curve}")
    return f"{plain(scene)}, at the quality of each other codec: ours takes {', '.join(told)}"


def _span(worst: float, best: float) -> str:
    """From least to most saved, in percent."""
    if worst < 0 < best:
        return f"{-worst:.0f} % more to {best:.0f} % fewer"
    ends = sorted({f"{abs(worst):.0f}", f"{abs(best):.0f}"}, key=float)
    return f"{' to '.join(ends)} % {'fewer' if best > 0 else 'more'}"


def rate_finding(results: Results, scene: str) -> str:
    """What curves of ours take over the paper's."""
    rates = {line["curve"]: finite(line["percent"]) for line in results.of("bd-rate", scene)}
    told = [
        f"{curve} {abs(rates[curve] or 0):.0f} % {'fewer' if (rates[curve] or 0) <= 0 else 'more'}"
        for curve in CURVES
        if rates.get(curve) is not None
    ]
    name = plain(scene)
    if not told:
        return f"{name}: quality against bits a Gaussian"
    return f"{name}: {', '.join(told)} bits than EntropyGS at equal PSNR (BD-rate)"


def time_finding(results: Results, scene: str, looks: dict[str, Look]) -> str:
    """Which lossy codecs are on the front of both times."""
    encode, decode = (front_of(results, scene, way) for way in ("encode", "decode"))
    both = [looks[codec].name for codec in encode if codec in decode]
    name = plain(scene)
    if not both:
        return f"{name}: quality against time"
    return (
        f"{name}: no other lossy codec is both faster and better than {_listed(both)}, "
        "encoding or decoding"
    )


def stage_finding(lines: list[Line], scene: str) -> str:
    """What most of the time of the default profile goes to."""
    line = next((line for line in lines if line["profile"] == "m"), lines[0])
    stages = {name: s for name, s in line["stages"].items() if name not in DECODING}
    total = sum(stages.values())
    if not total:
        return f"{plain(scene)}: time by stage"
    most = max(stages, key=lambda name: stages[name])
    share = 100 * stages[most] / total
    return (
        f"{plain(scene)}: {share:.0f} % of encoding with {plain(line['profile'])} goes to stage "
        f"'{plain(most)}'"
    )


def memory_finding(lines: list[Line], scene: str) -> str:
    """The most memory that any profile takes."""
    peak = max(max(line["encode_peak_bytes"], line["decode_peak_bytes"]) for line in lines)
    floats = lines[0]["float_bytes"] / 1e6
    return (
        f"{plain(scene)}: no profile takes more than {peak / 1e6:.0f} MB of memory "
        f"for {floats:.1f} MB of floats"
    )


def scaling_finding(results: Results) -> str:
    """What a million Gaussians more take."""
    line = next(iter(sorted(results.of("growth"), key=lambda line: line["profile"] != "m")), {})
    known = [line.get(way, {}).get("seconds_per_million") for way in ("encode", "decode")]
    if None in known:
        return "Time and memory against the number of Gaussians"
    return (
        f"A million Gaussians more take {line['profile']} {known[0]:.1f} s of a processor to "
        f"encode and {known[1]:.1f} s to decode"
    )


def part_finding(lines: list[Line], scene: str) -> str:
    """Which part saves most."""
    most = max(lines, key=lambda line: finite(line["saved_bits"]) or 0.0)
    saved = finite(most["saved_bits"]) or 0.0
    what = plain(most["without"], 70)
    return f"{plain(scene)}: most is saved by {what}, {saved:.0f} bits a Gaussian"


def _listed(names: list[str]) -> str:
    shown = [f"“{name}”" if "," in name else name for name in names[:4]]
    if len(names) > len(shown):
        shown.append(f"{len(names) - len(shown)} others")
    return shown[0] if len(shown) == 1 else ", ".join(shown[:-1]) + " and " + shown[-1]

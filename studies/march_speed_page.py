"""The page of plots of march_speed.py."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("agg")
import matplotlib.pyplot as plt

# Okabe and Ito's colours; every line has a marker of its own as well.
STYLES = {
    "NumPy loop": {"color": "#000000", "marker": "x"},
    "by hand": {"color": "#888888", "marker": "s"},
    "HHT": {"color": "#0072B2", "marker": "o"},
    "BDF2": {"color": "#D55E00", "marker": "^"},
    "SDIRK-OS": {"color": "#009E73", "marker": "D"},
    "exact": {"color": "#56B4E9", "marker": "P"},
}


def draw(record: dict, file: Path) -> None:
    """Scaling in M, in steps, in members and in threads, and the costs of Table 10 side by side."""
    figure, ((cells, steps, members), (threads, costs, parts)) = plt.subplots(
        2, 3, figsize=(15.5, 8.5), layout="constrained"
    )
    sizes = [int(M) for M in record["single"]]
    for name in ("NumPy loop", "by hand", "HHT", "BDF2", "SDIRK-OS"):
        cells.loglog(sizes, [found[name] for found in record["single"].values()], label=name, **STYLES[name])
    cells.set(xlabel="cells M", ylabel="ns per step", title="One run of Table 10")
    cells.set_xticks(sizes, [str(M) for M in sizes])
    cells.minorticks_off()
    for name, points in record["steps"].items():
        steps.loglog([int(k) for k in points], [1e3 * x for x in points.values()], label=name, **STYLES[name])
    steps.set(xlabel="steps", ylabel="ms", title="integrate, every 100th step kept, set-up included", ylim=(1.0, 100.0))
    sizes = [int(k) for k in record["members"]]
    members.loglog(sizes, list(record["members"].values()), label="HHT", **STYLES["HHT"])
    members.set(
        xlabel="members",
        ylabel="ns per member-step",
        title=f"Ensembles of HHT on {record['cores']} cores, set-up included",
    )
    for axes in (steps, members):
        axes.minorticks_off()
    members.set_ylim(10.0, None)
    _threads(threads, record["threads"])
    for axes in (cells, steps, members, threads):
        axes.grid(True, which="major", alpha=0.3)
        axes.legend(frameon=False)
    _bars(costs, record)
    _whole(parts, record)
    figure.savefig(file, dpi=150)
    plt.close(figure)


def _threads(axes, record: dict) -> None:
    """Times as fast as on one thread; the ideal dashed."""
    counts = [int(count) for count in record["exact"]]
    axes.plot(counts, counts, color="#888888", linestyle="--", label="ideal")
    for name, times in record.items():
        axes.plot(counts, [times["1"] / seconds for seconds in times.values()], label=name, **STYLES[name])
    axes.set(xlabel="threads", ylabel="times as fast as on one", title="Ensembles, wall time", ylim=(0.0, None))
    axes.set_xticks(counts)


def _whole(axes, record: dict) -> None:
    """A step of ``integrate`` with every step kept, and what the energy ledger takes when asked for."""
    march, whole = record["single"]["25"], record["whole"]
    names = ("HHT", "BDF2", "SDIRK-OS")[::-1]
    parts = {
        "march": [march[name] for name in names],
        "set-up and output": [whole[f"{name}, whole run"] - march[name] for name in names],
        "energy ledger, when asked for": [whole[f"{name}, ledger"] for name in names],
    }
    left = [0.0] * len(names)
    for (label, widths), colour in zip(parts.items(), ("#0072B2", "#56B4E9", "#E69F00"), strict=True):
        axes.barh(names, widths, left=left, label=label, color=colour)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.set(xlabel="ns per step", title="integrate, every step kept")
    axes.set_ylim(-0.6, len(names))
    axes.legend(frameon=False, loc="upper center", ncols=2, fontsize=8)


def _bars(axes, record: dict) -> None:
    single, ensemble = record["single"]["25"], record["ensemble"]
    schemes = ("HHT", "BDF2", "SDIRK-OS")
    bars = {"by hand": single["by hand"]}
    bars |= {f"{name}, one run": single[name] for name in schemes}
    bars |= {f"{name}, streamed only": record["bound"][f"{name}, bound ns"] for name in schemes}
    bars |= {f"{name}, member": ensemble[name] for name in schemes}
    bars |= {f"{name}, member": x for name, x in ensemble.items() if "frequencies" in name}
    names = list(bars)[::-1]
    colours = [STYLES[name.split(",")[0]]["color"] for name in names]
    axes.barh(names, [bars[name] for name in names], color=colours, alpha=0.85)
    axes.bar_label(axes.containers[0], fmt="%.1f", padding=3, fontsize=8)
    axes.set(xlabel="ns per step or member-step", title="Table 10, M = 25")
    axes.set_xlim(0, 1.12 * max(bars.values()))
    axes.tick_params(axis="y", labelsize=8)

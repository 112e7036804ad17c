"""Draws the simulation of scale: environment steps per second by number of actors.

    pip install matplotlib
    cargo run --release -p learner --example scale -- scale.csv
    python benches/python/scale_picture.py scale.csv docs/images/scale.png
"""

import argparse
import csv

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as pyplot

# Okabe and Ito's colours, as in the program's figures; marks tell the curves apart in grey, too.
STYLES = [("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^")]
WELL = "all well"
DISTURBED = "ant-4x2, slow simulator"
# Labels of the left panel, and how many points they are moved up.
TASKS = {
    "halfcheetah-6x1": ("HalfCheetah 6x1", 0),
    "ant-4x2": ("Ant 4x2", 5),
    "ant-4x2, slow simulator": ("slow simulator", -7),
}
# The same for the right panel. Curves without backups are the same but for a few percent.
VARIANTS = {
    "slow machines": ("5 % of machines\n3 times slower", -7),
    "preemptible": ("machines taken\nonce an hour", 14),
    "a failure a day": ("a failure a day", -13),
}


def read(path: str) -> dict[tuple[str, str], list[tuple[int, float]]]:
    """Points (actors, environment steps per second) by task and variant."""
    curves = {}
    with open(path, newline="") as lines:
        for row in csv.DictReader(lines):
            point = (int(row["actors"]), float(row["steps_per_sec"]))
            curves.setdefault((row["task"], row["variant"]), []).append(point)
    return curves


def draw(axes, points, style, label, rise):
    """A curve with its label at the right end, moved up by `rise` points."""
    colour, marker = style
    axes.plot(*zip(*points), color=colour, marker=marker, markersize=4, linewidth=1.5)
    place = {"xytext": (6, rise), "textcoords": "offset points", "va": "center", "fontsize": 8}
    axes.annotate(label, points[-1], color=colour, annotation_clip=False, **place)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("csv")
    parser.add_argument("picture")
    arguments = parser.parse_args()
    curves = read(arguments.csv)
    figure, (left, right) = pyplot.subplots(1, 2, figsize=(9.6, 3.4), dpi=110)
    for (task, (label, rise)), style in zip(TASKS.items(), STYLES):
        draw(left, curves[task, WELL], style, label, rise)
    left.set_yscale("log")
    left.set_ylabel("environment steps/s")
    left.set_title("One learner of 16 threads", fontsize=9)
    well = dict(curves[DISTURBED, WELL])
    for (variant, (label, rise)), style in zip(VARIANTS.items(), STYLES):
        share = [(actors, 100 * rate / well[actors]) for actors, rate in curves[DISTURBED, variant]]
        draw(right, share, style, label, rise)
    right.set_ylim(0, 105)
    right.set_ylabel("% of the rate without faults")
    right.set_title("Slow simulator, disturbed", fontsize=9)
    for axes in (left, right):
        axes.set_xscale("log")
        axes.set_xlabel("actors")
        axes.grid(linewidth=0.4, color="#cccccc")
        axes.spines[["top", "right"]].set_visible(False)
    figure.tight_layout(w_pad=6)
    figure.savefig(arguments.picture)


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""Draws the README's picture from a real result: plot.py CHECK.json RUN.csv TRAJECTORY.csv OUT.svg

CHECK.json is of `clampctl run --json`, RUN.csv one of its repeats or of `clampctl simulate`, TRAJECTORY.csv the reference.
Needs Debian's python3-matplotlib.
"""
import csv
import json
import sys

import matplotlib

matplotlib.use("svg")
import matplotlib.pyplot as plt


def columns(path):
    with open(path, newline="") as file:
        rows = list(csv.DictReader(file))
    return {name: [float(row[name]) for row in rows] for name in rows[0]}


def main(check_file, run_file, trajectory_file, out_file):
    with open(check_file) as file:
        check = json.load(file)
    run, reference = columns(run_file), columns(trajectory_file)
    matplotlib.rcParams.update({"font.size": 9, "axes.spines.top": False, "axes.spines.right": False,
                                "svg.hashsalt": "clampd", "svg.fonttype": "path"})
    figure = plt.figure(figsize=(10, 5.2))
    grid = figure.add_gridspec(3, 2, width_ratios=[1.5, 1], hspace=0.25, wspace=0.28)
    ms = [1e3 * t for t in run["time_s"]]
    for row, (name, scale, label) in enumerate([("force_N", 1e-3, "clamp force, kN"),
                                                ("velocity_rad_s", 1, "motor speed, rad/s"),
                                                ("torque_Nm", 1, "motor torque, N m")]):
        axes = figure.add_subplot(grid[row, 0])
        axes.plot([1e3 * t for t in reference["time_s"]], [scale * v for v in reference[name]], color="0.6", lw=2.5,
                  label="reference (nominal brake)", drawstyle="steps-post" if name == "torque_Nm" else "default")
        axes.plot(ms, [scale * v for v in run[name]], color="C0", lw=0.9, label="measured",
                  drawstyle="steps-post" if name == "torque_Nm" else "default")
        axes.set_ylabel(label)
        if row == 0:
            axes.legend(frameon=False, loc="lower right")
        if row < 2:
            axes.set_xticklabels([])
        else:
            axes.set_xlabel("time, ms")
    axes = figure.add_subplot(grid[:, 1])
    for i, p in enumerate(check["parameters"]):
        y = len(check["parameters"]) - i
        place = lambda value: (value - p["lower"]) / (p["upper"] - p["lower"])
        axes.plot([0, 1], [y, y], color="0.85", lw=9, solid_capstyle="butt")
        colour = {"pass": "C2", "marginal": "C1", "fail": "C3"}[p["verdict"]]
        axes.errorbar(place(p["value"]), y, xerr=2 * p["sd"] / (p["upper"] - p["lower"]), fmt="o", ms=5, color=colour,
                      capsize=3)
        axes.text(-0.04, y, p["name"], ha="right", va="center", weight="bold")
        axes.text(1.04, y, f"{p['value']:.4g} ± {p['sd']:.1g} {p['unit']}", va="center", fontsize=8)
    axes.set_title(f"{check['verdict']}   {check['serial']}", weight="bold", color="C2" if check["verdict"] == "PASS" else "C3")
    axes.text(0.5, 0.25, f"{check['repeats']} repeats, {check['duration_s']:.1f} s on the bench; bars: limits; whiskers: ± 2 sd",
              ha="center", fontsize=8, color="0.4")
    axes.set_xlim(-0.05, 1.05)
    axes.set_ylim(0, len(check["parameters"]) + 0.6)
    axes.axis("off")
    figure.savefig(out_file, bbox_inches="tight", metadata={"Date": None})


if __name__ == "__main__":
    if len(sys.argv) != 5:
        sys.exit(__doc__)
    main(*sys.argv[1:])

"""scipy.optimize.least_squares on the runs that bench_against wrote: output errors, and innovations of an
extended Kalman filter. usage: estimation.py DIRECTORY; reads cases.json there, writes scipy.json."""

import json
import pathlib
import sys
import time

import numba
import numpy as np
import scipy
from numba import njit
from scipy.optimize import least_squares

from brake import INERTIA, NOMINAL, STEP, force, simulate, step


def read_run(path):
    return np.ascontiguousarray(np.genfromtxt(path, delimiter=",", names=True))


@njit
def output_errors(unknowns, torque, forces, velocities, sd_force, sd_velocity, sd_torque):
    n = torque.size
    f = np.empty(n)
    v = np.empty(n)
    simulate(unknowns[:7] * NOMINAL, unknowns[7], unknowns[8], torque, f, v)
    return np.concatenate(((forces - f) / sd_force, (velocities - v) / sd_velocity))


@njit
def innovations(unknowns, torque, forces, velocities, sd_force, sd_velocity, sd_torque):
    """Whitened by their own covariance; the filter's A, B and C by differences."""
    theta = unknowns[:7] * NOMINAL
    x, v = unknowns[7], unknowns[8]
    p = np.zeros((2, 2))
    a = np.empty((2, 2))
    b = np.empty(2)
    e = np.empty(2)
    c = np.zeros((2, 2))
    c[1, 1] = 1.0
    r = np.diag(np.array([sd_force**2, sd_velocity**2]))
    residuals = np.empty(2 * torque.size)
    dx, dv, dt = 1e-6, 1e-5, 1e-6
    for k in range(torque.size):
        c[0, 0] = (force(theta, x + dx) - force(theta, x - dx)) / (2.0 * dx)
        s = c @ p @ c.T + r
        e[0] = forces[k] - force(theta, x)
        e[1] = velocities[k] - v
        l00 = np.sqrt(s[0, 0])
        l10 = s[1, 0] / l00
        residuals[2 * k] = e[0] / l00
        residuals[2 * k + 1] = (e[1] - l10 * residuals[2 * k]) / np.sqrt(s[1, 1] - l10**2)
        gain = p @ c.T @ np.linalg.inv(s)
        x += gain[0, 0] * e[0] + gain[0, 1] * e[1]
        v += gain[1, 0] * e[0] + gain[1, 1] * e[1]
        p = (np.eye(2) - gain @ c) @ p
        next_x, next_v = step(theta, x, v, torque[k], STEP)
        x1, v1 = step(theta, x + dx, v, torque[k], STEP)
        a[0, 0], a[1, 0] = (x1 - next_x) / dx, (v1 - next_v) / dx
        x1, v1 = step(theta, x, v + dv, torque[k], STEP)
        a[0, 1], a[1, 1] = (x1 - next_x) / dv, (v1 - next_v) / dv
        x1, v1 = step(theta, x, v, torque[k] + dt, STEP)
        b[0], b[1] = (x1 - next_x) / dt, (v1 - next_v) / dt
        p = a @ p @ a.T + np.outer(b, b) * sd_torque**2
        x, v = next_x, next_v
    return residuals


def fit(method, run, noise, start):
    residuals = output_errors if method == "oem" else innovations
    data = (run["torque_Nm"].copy(), run["force_N"].copy(), run["velocity_rad_s"].copy(), *noise)
    unknowns = np.concatenate((np.asarray(start), np.zeros(2)))
    residuals(unknowns, *data)  # compiled before the clock starts
    before = time.process_time()
    solution = least_squares(residuals, unknowns, args=data, x_scale="jac")
    return {"seconds": time.process_time() - before, "normalised": list(solution.x[:7]), "evaluations": solution.nfev}


def largest_differences(run, normalised):
    f, v = np.empty(run.size), np.empty(run.size)
    simulate(np.asarray(normalised) * NOMINAL, 0.0, 0.0, run["torque_Nm"].copy(), f, v)
    return {"force_N": np.max(np.abs(f - run["force_N"])), "velocity_rad_s": np.max(np.abs(v - run["velocity_rad_s"]))}


def main():
    directory = pathlib.Path(sys.argv[1])
    task = json.loads((directory / "cases.json").read_text())
    check = task["same_model"]
    result = {
        "versions": f"scipy {scipy.__version__}, numba {numba.__version__}",
        "differences": largest_differences(read_run(directory / check["run"]), check["normalised"]),
        "cases": [
            [fit(case["method"], read_run(directory / run), case["noise"], start) for run, start in case["fits"]]
            for case in task["cases"]
        ],
    }
    (directory / "scipy.json").write_text(json.dumps(result))


main()

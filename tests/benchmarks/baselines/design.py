"""scipy's SLSQP from random starts for the D-optimal experiment, with forward differences and numba.
usage: design.py DIRECTORY; reads task.json there, writes slsqp.json."""

import json
import pathlib
import sys
import time

import numpy as np
from numba import njit
from scipy.optimize import minimize

from brake import NOMINAL, simulate

DIFFERENCE = 1e-6  # of a parameter, for the sensitivities
STRIDE = 1e-5  # of a torque, for the optimiser's gradients


@njit
def evaluate(blocks, block_samples, sd_force, sd_velocity, force_limit, speed_limit, out):
    """-log det M of the normalised parameters, then the room to both limits in each block, into out."""
    n = blocks.size * block_samples
    torque = np.repeat(blocks, block_samples)
    f, v = np.empty(n), np.empty(n)
    columns = np.empty((2 * n, 7))
    for i in range(7):
        for direction in (1.0, -1.0):
            theta = NOMINAL.copy()
            theta[i] *= 1.0 + direction * DIFFERENCE
            simulate(theta, 0.0, 0.0, torque, f, v)
            readings = np.concatenate((f / sd_force, v / sd_velocity))
            columns[:, i] = readings if direction > 0.0 else (columns[:, i] - readings) / (2.0 * DIFFERENCE)
    information = columns.T @ columns
    out[:] = -1e3  # where it diverges, or tells nothing
    out[0] = 1e3
    if not np.all(np.isfinite(information)):
        return
    sign, logdet = np.linalg.slogdet(information)
    if sign <= 0.0:
        return
    out[0] = -logdet
    simulate(NOMINAL, 0.0, 0.0, torque, f, v)
    for b in range(blocks.size):
        rows = slice(b * block_samples, (b + 1) * block_samples)
        out[1 + 2 * b] = 1.0 - np.max(f[rows]) / force_limit
        out[2 + 2 * b] = 1.0 - np.max(np.abs(v[rows])) / speed_limit


class Problem:
    """Objective and constraints from one evaluation, as they share the simulations."""

    def __init__(self, task):
        self.scale = task["torque_limit_Nm"]
        self.settings = (
            task["block_samples"],
            task["noise_force_N"],
            task["noise_velocity_rad_s"],
            task["force_limit_N"],
            task["speed_limit_rad_s"],
        )
        self.size = 1 + 2 * task["blocks"]
        self.values_at = self.slopes_at = None

    def compute(self, x):
        out = np.empty(self.size)
        evaluate(self.scale * x, *self.settings, out)
        return out

    def values(self, x):
        if not np.array_equal(x, self.values_at):
            self.values_at, self.last = x.copy(), self.compute(x)
        return self.last

    def slopes(self, x):
        if not np.array_equal(x, self.slopes_at):
            here = self.values(x)
            moved = [self.compute(x + STRIDE * unit) for unit in np.eye(x.size)]
            self.slopes_at, self.last_slopes = x.copy(), (np.array(moved) - here).T / STRIDE
        return self.last_slopes


def main():
    directory = pathlib.Path(sys.argv[1])
    task = json.loads((directory / "task.json").read_text())
    problem = Problem(task)
    rng = np.random.default_rng(task["seed"])
    problem.slopes(np.zeros(task["blocks"]))  # compiled before the clock starts
    started = time.process_time()
    designs = []
    while time.process_time() - started < task["budget_s"]:
        solution = minimize(
            lambda x: problem.values(x)[0],
            rng.uniform(-1.0, 1.0, task["blocks"]),
            jac=lambda x: problem.slopes(x)[0],
            bounds=[(-1.0, 1.0)] * task["blocks"],
            constraints={"type": "ineq", "fun": lambda x: problem.values(x)[1:], "jac": lambda x: problem.slopes(x)[1:]},
            method="SLSQP",
            options={"maxiter": 300, "ftol": 1e-4},
        )
        designs.append(
            {
                "feasible": bool(np.min(problem.values(solution.x)[1:]) >= -1e-4),
                "logdet": float(solution.fun),
                "blocks_Nm": list(problem.scale * solution.x),
                "seconds": time.process_time() - started,
            }
        )
    (directory / "slsqp.json").write_text(json.dumps(designs))


main()

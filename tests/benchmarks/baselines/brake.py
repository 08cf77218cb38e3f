"""The brake as a user of numpy and numba would write it: equations (2) to (5) with a set-valued sign.

RK4 over a sample with the sign of friction frozen, the instant of v = 0 found inside of it, then stick or
go on in the direction of the load. theta = k1, k2, TC, Ts0, Tv, mus, ws in SI units.
"""

import numpy as np
from numba import njit

NOMINAL = np.array([-3.54e-1, 3.52e1, 7.67e-2, 4.68e-2, 4.46e-4, 3.55e-5, 2.89e1])
INERTIA = 2.91e-4
RATIO = 2.63e-5
STEP = 1e-3


@njit
def force(theta, x):
    return x * x * (theta[0] * x + theta[1]) if x > 0.0 else 0.0


@njit
def acceleration(theta, x, v, torque, sign):
    load = force(theta, x)
    stiction = theta[3] + theta[5] * load
    friction = theta[4] * v + sign * (theta[2] + (stiction - theta[2]) / (1.0 + (v / theta[6]) ** 2))
    return (torque - RATIO * load - friction) / INERTIA


@njit
def runge_kutta(theta, x, v, torque, sign, h):
    a0 = acceleration(theta, x, v, torque, sign)
    v1 = v + 0.5 * h * a0
    a1 = acceleration(theta, x + 0.5 * h * v, v1, torque, sign)
    v2 = v + 0.5 * h * a1
    a2 = acceleration(theta, x + 0.5 * h * v1, v2, torque, sign)
    v3 = v + h * a2
    a3 = acceleration(theta, x + h * v2, v3, torque, sign)
    return x + h / 6.0 * (v + 2.0 * v1 + 2.0 * v2 + v3), v + h / 6.0 * (a0 + 2.0 * a1 + 2.0 * a2 + a3)


@njit
def step(theta, x, v, torque, h):
    for _ in range(8):
        if v > 0.0:
            sign = 1.0
        elif v < 0.0:
            sign = -1.0
        else:
            load = torque - RATIO * force(theta, x)
            if abs(load) <= theta[3] + theta[5] * force(theta, x):
                return x, 0.0
            sign = 1.0 if load > 0.0 else -1.0
        x_end, v_end = runge_kutta(theta, x, v, torque, sign, h)
        if not sign * v_end < 0.0:
            return x_end, v_end
        t = h * v / (v - v_end) if v != 0.0 else 0.5 * h
        for _ in range(20):  # Newton's method for v(t) = 0
            x_end, v_end = runge_kutta(theta, x, v, torque, sign, t)
            change = v_end / acceleration(theta, x_end, v_end, torque, sign)
            t = min(max(t - change, 0.0), h)
            if abs(change) < 1e-15:
                break
        x, v = runge_kutta(theta, x, v, torque, sign, t)[0], 0.0
        h -= t
        if h <= 0.0:
            break
    return x, v


@njit
def simulate(theta, x, v, torque, forces, velocities):
    """Readings at each sample; torque[k] acts from sample k."""
    for k in range(torque.size):
        forces[k] = force(theta, x)
        velocities[k] = v
        x, v = step(theta, x, v, torque[k], STEP)

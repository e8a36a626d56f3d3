"""Land et al. 2017 written a second time, for tests/models/force.cpp: python tests/data/make_land2017.py

Times in ms, as in the authors' program; integrated by scipy's LSODA at tight tolerances. Nothing of the C++ model is used.
Writes cell/land2017_rhs.csv (rates at random states), cell/land2017_force_calcium.csv (steady tension, from the closed
form that follows from the paper's equations) and cell/land2017_twitch.csv (a twitch with shortening).
"""

from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

FOLDER = Path(__file__).parent / "cell"
SETS = {
    "intact": {"ntm": 5.0, "ca50": 0.805, "Tref": 120.0, "nu": 7.0, "mu": 3.0, "ku": 1.0},
    "skinned": {"ntm": 2.2, "ca50": 2.5, "Tref": 40.5, "nu": 1.0, "mu": 1.0, "ku": 1.0},
    "margara2021": {"ntm": 2.4, "ca50": 0.805, "Tref": 120.0, "nu": 7.0, "mu": 3.0, "ku": 0.04},
}
PERM50, DR, WFRAC, KOFF, TOT_A, PHI, GAMMA, GAMMA_WU, BETA_0, BETA_1 = 0.35, 0.25, 0.5, 0.1, 25.0, 2.23, 0.0085, 0.615, 2.3, -2.4
SL0 = 1.9


def overlap(stretch):
    longest = min(stretch, 1.2)
    return max(0.0, 1 + BETA_0 * (longest + min(longest, 0.87) - 1.87))


def calcium_50(values, stretch):
    return values["ca50"] + BETA_1 * (min(stretch, 1.2) - 1)


def rates(values, y, calcium, stretch, stretch_rate):
    """Of (CaTRPN, B, W, S, zeta_w, zeta_s) per ms, and the tension in kPa."""
    troponin, blocked, weak, strong, zeta_w, zeta_s = y
    kuw, kws = 0.026 * values["nu"], 0.004 * values["mu"]
    if values["nu"] > 1:  # the paper prints 182 and 12 per second
        kuw, kws = 0.182, 0.012
    cdw = PHI * kuw * (1 - DR) * (1 - WFRAC) / ((1 - DR) * WFRAC)
    cds = PHI * kws * (1 - DR) * WFRAC / DR
    kwu, ksu = kuw * (1 / WFRAC - 1) - kws, kws * (1 / DR - 1) * WFRAC
    A = TOT_A * DR / ((1 - DR) * WFRAC + DR)
    unbound = 1 - blocked - weak - strong
    beyond = zeta_s if zeta_s > 0 else -zeta_s - 1 if zeta_s < -1 else 0.0
    kb = values["ku"] * PERM50 ** values["ntm"] / (1 - DR - (1 - DR) * WFRAC)
    d_troponin = KOFF * ((calcium / calcium_50(values, stretch)) ** 2 * (1 - troponin) - troponin)
    d_blocked = kb * min(100.0, troponin ** (-values["ntm"] / 2)) * unbound - values["ku"] * troponin ** (values["ntm"] / 2) * blocked
    d_weak = kuw * unbound - (kwu + kws + GAMMA_WU * abs(zeta_w)) * weak
    d_strong = kws * weak - (ksu + GAMMA * beyond) * strong
    tension = overlap(stretch) * values["Tref"] / DR * ((zeta_s + 1) * strong + zeta_w * weak)
    return [d_troponin, d_blocked, d_weak, d_strong, A * stretch_rate - cdw * zeta_w, A * stretch_rate - cds * zeta_s], tension


def steady_tension(values, calcium, stretch):
    """Where nothing moves: W and S stand in fixed shares to U, and B/U is the ratio of blocking and unblocking."""
    ratio = (calcium / calcium_50(values, stretch)) ** 2
    troponin = ratio / (1 + ratio)
    half = troponin ** (values["ntm"] / 2)
    blocking = PERM50 ** values["ntm"] / ((1 - DR) * (1 - WFRAC)) * min(100.0, 1 / half) / half
    unbound = 1 / (1 / ((1 - DR) * (1 - WFRAC)) + blocking)
    return overlap(stretch) * values["Tref"] * unbound / ((1 - DR) * (1 - WFRAC))


def twitch_calcium(t_ms):
    """0.1 to 0.8 uM, 20 and 90 ms, from 20 ms on."""
    if t_ms < 20:
        return 0.1
    shape = np.exp(-(t_ms - 20) / 90) - np.exp(-(t_ms - 20) / 20)
    at_peak = np.log(90 / 20) * 90 * 20 / (90 - 20)
    return 0.1 + 0.7 * shape / (np.exp(-at_peak / 90) - np.exp(-at_peak / 20))


def twitch_stretch(t_ms):
    """1.1, shortened to 1 between 100 and 250 ms, and its rate per ms."""
    if t_ms <= 100:
        return 1.1, 0.0
    if t_ms < 250:
        return 1.1 - 0.1 * (t_ms - 100) / 150, -0.1 / 150
    return 1.0, 0.0


def main():
    random = np.random.default_rng(3)
    lines = ["set,Ca,SL,dSL/dt,CaTRPN,B,W,S,zeta_w,zeta_s,dCaTRPN/dt,dB/dt,dW/dt,dS/dt,dzeta_w/dt,dzeta_s/dt,Ta"]
    for index, (_, values) in enumerate(SETS.items()):
        for _ in range(12):
            chain = random.dirichlet(np.ones(4))
            y = [random.uniform(0.02, 0.98), *chain[1:], random.uniform(-1, 1), random.uniform(-2, 2)]
            calcium, stretch, speed = random.uniform(0.05, 3), random.uniform(0.8, 1.3), random.uniform(-2, 2)
            d, tension = rates(values, y, calcium, stretch, 1e-3 * speed)
            row = [index, calcium, SL0 * stretch, SL0 * speed, *y, *(1e3 * x for x in d), tension]
            lines.append(",".join(f"{x:.17g}" for x in row))
    (FOLDER / "land2017_rhs.csv").write_text("\n".join(lines) + "\n")
    lines = ["set,Ca,SL,Ta"]
    for index, values in enumerate(SETS.values()):
        for stretch in (0.85, 1.0, 1.15, 1.25):
            for calcium in np.geomspace(0.1, 20, 12):
                lines.append(",".join(f"{x:.17g}" for x in (index, calcium, SL0 * stretch, steady_tension(values, calcium, stretch))))
    (FOLDER / "land2017_force_calcium.csv").write_text("\n".join(lines) + "\n")
    lines = ["set,t,Ta"]
    for index, values in enumerate(SETS.values()):
        ratio = (0.1 / calcium_50(values, 1.1)) ** 2
        troponin = ratio / (1 + ratio)
        y, rest = np.array([troponin, 1, 0, 0, 0, 0], float), []
        # At rest to begin with, then in pieces: calcium and stretch have kinks.
        y = solve_ivp(lambda t, y: rates(values, y, 0.1, 1.1, 0)[0], (0, 1e5), y, method="LSODA", rtol=1e-11, atol=1e-14).y[:, -1]
        for begin, end in ((0, 20), (20, 100), (100, 250), (250, 600)):
            times = np.arange(begin + 10, end + 1, 10)
            middle = 0.5 * (begin + end)
            slope = twitch_stretch(middle)[1]
            base = twitch_stretch(begin)[0]
            part = solve_ivp(lambda t, y: rates(values, y, twitch_calcium(t), base + slope * (t - begin), slope)[0], (begin, end), y,
                             method="LSODA", rtol=1e-11, atol=1e-14, t_eval=times, max_step=1.0)
            rest += [(t, rates(values, part.y[:, k], twitch_calcium(t), base + slope * (t - begin), slope)[1]) for k, t in enumerate(times)]
            y = part.y[:, -1]
        lines += [f"{index},{1e-3 * t:.17g},{tension:.17g}" for t, tension in rest]
    (FOLDER / "land2017_twitch.csv").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

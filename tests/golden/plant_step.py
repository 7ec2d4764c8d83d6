"""Exact one-step matrices of a mass-spring-damper under a constant force: plant_step.csv.

    x'' = (F - b x' - k x) / m,   state (x, v),   F constant over T
    (x, v)(t + T) = phi (x, v)(t) + gamma F

phi and gamma come from mpmath's expm of the 3x3 matrix [[0, 1, 0], [-k/m, -b/m, 1/m], [0, 0, 0]] T.
Every value is computed twice, with a different method and precision (Taylor at PRECISION digits, Pade
at PRECISION + 30), and both must agree to 50 digits relative to the largest entry. Rows of exact physics
are asserted as well: det phi = exp(-b T / m). The inputs are the doubles printed (mass to T), taken exactly.

Made with Python 3, mpmath 1.3.0. Deterministic: run `python3 plant_step.py` in this directory.
"""

import csv
from mpmath import mp, mpf, matrix, expm, exp, nstr, log10, ceil

DIGITS = 25  # printed
AGREE = 50  # digits to which two methods must agree

# The paper's device at the steps of its controller, and the two halves of a step split at a latency.
PAPER = [(0.4160, 5.5195, 11.0626, t) for t in (1e-3, 1e-4, 2e-5, 0.3e-4, 0.7e-4)]

# mass kg, damping N s/m, stiffness N/m, T s
OTHERS = [
    # undamped
    (1.0, 0.0, 0.0, 1e-3),
    (0.416, 0.0, 11.0626, 1e-4),
    (0.416, 0.0, 1e6, 1e-4),
    (1e-3, 0.0, 1e9, 1e-3),  # 159 oscillations in one step
    (1e-3, 0.0, 1e9, 2e-5),
    (100.0, 0.0, 1e9, 1e-3),
    (100.0, 0.0, 1e-3, 2e-5),
    (0.25, 0.0, 1e5, 3.7e-4),
    # free, damped: no spring
    (1.0, 1.0, 0.0, 1e-3),
    (1e-3, 1e6, 0.0, 1e-3),
    (100.0, 1e-2, 0.0, 2e-5),
    (1e-3, 1.0, 0.0, 1e-3),  # time constant = T
    # critically damped (b^2 = 4 k m exactly in doubles) and within rounding of it
    (1.0, 2.0, 1.0, 1e-3),
    (0.25, 1000.0, 1e6, 1e-3),  # w T = 2
    (0.25, 1000.0, 1e6, 2e-5),
    (0.25, 31622.776601683792, 1e9, 1e-3),  # w T = 63
    (0.25, 1000.0 * (1 + 1e-9), 1e6, 1e-3),
    (0.25, 1000.0 * (1 - 1e-9), 1e6, 1e-3),
    (0.25, 1000.0 * (1 + 1e-5), 1e6, 1e-4),
    (0.25, 1000.0 * (1 - 1e-5), 1e6, 1e-4),
    (0.25, 1000.1, 1e6, 2.5e-4),  # near critical, near w T = 1/2
    # overdamped, stiff: a time constant far below T
    (1e-3, 1e6, 1e9, 1e-3),
    (1e-3, 1e6, 1.0, 1e-3),
    (1e-3, 1e6, 1.0, 2e-5),
    (1e-3, 1e3, 1e3, 1e-3),
    (0.416, 1e5, 1e3, 1e-4),
    (100.0, 1e6, 1e7, 1e-3),
    (100.0, 1e6, 1e-2, 1e-3),
    (1.0, 1e3, 1.0, 1e-3),  # slow pole at T/1e6
    (1.0, 1.1e3, 2.4e5, 1e-3),
    # lightly damped, stiff, and in between
    (1e-3, 1e-2, 1e9, 1e-3),
    (0.416, 5.5195, 1e7, 1e-4),
    (0.416, 55.0, 1e5, 1e-4),
    (10.0, 1e3, 1e8, 5e-4),
    (0.05, 3.0, 2e3, 1e-3),
    (100.0, 1e-3, 1e-3, 1e-3),
    (1.0, 500.0, 2.5e5, 1e-3),
    (0.416, 416.0, 1e5, 1e-3),
]


def step(mass, damping, stiffness, dt, method, digits):
    # Squaring loses about log10(|A| T) digits, the fast decay of phi another 0.43 b T / m: carry them.
    size = mpf(stiffness) / mass * dt * dt + mpf(damping) / mass * dt + dt + 1
    mp.dps = digits + 2 * int(ceil(log10(size))) + 20
    m, b, k, t = mpf(mass), mpf(damping), mpf(stiffness), mpf(dt)
    a = matrix([[0, 1, 0], [-k / m, -b / m, 1 / m], [0, 0, 0]]) * t
    e = expm(a, method=method)
    return [e[0, 0], e[0, 1], e[1, 0], e[1, 1], e[0, 2], e[1, 2]]


def main():
    with open("plant_step.csv", "w", newline="") as out:
        rows = csv.writer(out, lineterminator="\n")
        rows.writerow(
            "mass_kg,damping_n_s_per_m,stiffness_n_per_m,period_s,phi11,phi12,phi21,phi22,gamma1,gamma2".split(",")
        )
        for mass, damping, stiffness, dt in PAPER + OTHERS:
            one = step(mass, damping, stiffness, dt, "taylor", AGREE + 20)
            two = step(mass, damping, stiffness, dt, "pade", AGREE + 50)
            mp.dps = 200
            for values in ((0, 1, 2, 3), (4, 5)):
                largest = max(abs(two[i]) for i in values)
                for i in values:
                    assert abs(one[i] - two[i]) <= largest * mpf(10) ** -AGREE, (mass, damping, stiffness, dt, i)
            determinant = two[0] * two[3] - two[1] * two[2]
            assert abs(determinant - exp(-mpf(damping) * mpf(dt) / mpf(mass))) < mpf(10) ** -AGREE
            rows.writerow(
                [repr(float(v)) for v in (mass, damping, stiffness, dt)]
                + [nstr(v, DIGITS, strip_zeros=False, min_fixed=0, max_fixed=0) for v in two]
            )


if __name__ == "__main__":
    main()

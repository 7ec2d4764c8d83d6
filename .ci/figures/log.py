"""A record of the paper's device, as a reader would bring one: a pulse of each sign, then nothing; 2 s at 10 kHz."""

import math

MASS, DAMPING, STIFFNESS, REST, GAIN = 0.416, 5.5195, 11.0626, 0.0517, 0.59
STEPS = 50  # of the motion, for each row

print("time_s,voltage_v,position_m")
x, v = REST, 0.0
for n in range(20_000):
    volts = 4.0 if 500 <= n < 2500 else -4.0 if 2500 <= n < 4500 else 0.0
    print(f"{n / 1e4:.4f},{volts},{math.floor(x * 1e6) / 1e6:.6f}")
    for _ in range(STEPS):
        v += (GAIN * volts - DAMPING * v - STIFFNESS * (x - REST)) / MASS * 1e-4 / STEPS
        x += v * 1e-4 / STEPS

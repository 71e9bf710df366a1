#!/usr/bin/env python3
"""Writes propagator.csv: the exact solution of x'' = -omega^2 x - 2 kappa x' + f over a time h, in 100 digits.

    python3 tests/reference/propagator.py > tests/reference/propagator.csv      (needs mpmath)

Columns are the arguments and the fields of `Propagator`. The arguments are doubles, written so that they read back to
the same bits; the results are those of exactly these doubles, rounded to 17 digits. From the impulse response
S(t) = exp(-kappa t) sinh(mu t) / mu, mu^2 = kappa^2 - omega^2 (mu may be imaginary):

    xx = S' + 2 kappa S,   xu = S,   ux = -omega^2 S,   uu = S',
    constant = int_0^h S(s) ds,   ramp = int_0^h S(h - s) s/h ds,   ramp_u = constant / h
"""

from mpmath import cosh, exp, mp, mpf, nstr, quad, re, sinh, sqrt

mp.dps = 100


def impulse_response(omega, kappa, t):
    """S(t) and S'(t)."""
    mu = sqrt(kappa * kappa - omega * omega)  # complex below critical damping
    if mu == 0:
        return t * exp(-kappa * t), (1 - kappa * t) * exp(-kappa * t)
    s = exp(-kappa * t) * sinh(mu * t) / mu
    ds = exp(-kappa * t) * cosh(mu * t) - kappa * s
    return re(s), re(ds)


def propagator(omega, kappa, h):
    s, ds = impulse_response(omega, kappa, h)
    if omega != 0:
        # integrate the equation once from 0 to h, for f = 1 and for f = t/h
        constant = (1 - (ds + 2 * kappa * s)) / omega**2
        ramp = (1 - (2 * kappa * constant + s) / h) / omega**2
    elif kappa != 0:
        constant = (h - s) / (2 * kappa)
        ramp = (h / 2 - constant / h) / (2 * kappa)
    else:
        constant, ramp = h * h / 2, h * h / 6
    if (omega + kappa) * h < 20:  # the integrals themselves, where they are easy
        check = quad(lambda t: impulse_response(omega, kappa, t)[0], [0, h / 2, h])
        assert abs(check - constant) < 1e-25 * abs(constant), (omega, kappa, h)
        check = quad(lambda t: impulse_response(omega, kappa, h - t)[0] * t / h, [0, h / 2, h])
        assert abs(check - ramp) < 1e-25 * abs(ramp), (omega, kappa, h)
    return ds + 2 * kappa * s, s, -omega**2 * s, ds, constant, ramp, constant / h


def main():
    eps = 2.0**-52
    ratios = [0.0, 1e-3, 0.1, 0.7, 1 - 1e-3, 1 - 1e-9, 1 - eps, 1.0, 1 + eps, 1 + 1e-9, 1 + 1e-3, 1.5, 3.0, 100.0, 1e6]
    phases = [1e-8, 1e-6, 1e-4, 1e-2, 0.2, 0.45, 1.0, 2.5, 10.0, 100.0, 1e3, 1e4, 1e6, 1e8]
    rows = [(phase * 60.0, ratio * phase * 60.0, 1 / 60) for ratio in ratios for phase in phases]
    # no restoring force, no force at all
    rows += [(0.0, kappa, 0.01) for kappa in (0.0, 1e-6, 1e-2, 1.0, 60.0, 1e4, 1e10)]
    # both sides of where the implementation changes its formula, and other steps than 1/60
    for h in (1e-6, 1.0, 1e3):
        rows += [(x / h, y / h, h) for x, y in (
            (0.5, 0.499), (0.5, 0.501), (0.334, 0.665), (0.334, 0.667), (0.33, 0.66), (1.0, 1.9999), (1.0, 2.0),
            (1e-4, 0.999), (1e-4, 1.001), (1.0, 1 + 1e-17), (1.0, 1.1), (1.0, 1.2), (9.9e-5, 0.0), (1.01e-4, 0.0),
        )]
    print("omega,kappa,h,xx,xu,ux,uu,constant,ramp,ramp_u")
    for omega, kappa, h in rows:
        results = propagator(mpf(omega), mpf(kappa), mpf(h))
        print(",".join([repr(x) for x in (omega, kappa, h)] + [nstr(x, 17, min_fixed=0, max_fixed=0) for x in results]))


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Writes propagator.csv: the exact solution of x'' = -omega^2 x - 2 kappa x' + f over a time h, in 300 digits.

    python3 tests/reference/propagator.py > tests/reference/propagator.csv      (needs mpmath)

Columns are the arguments and the fields of `Propagator`. The arguments are doubles, written so that they read back to
the same bits; the results are those of exactly these doubles, rounded to 17 digits. From the impulse response
S(t) = exp(-kappa t) sinh(mu t) / mu, mu^2 = kappa^2 - omega^2 (mu may be imaginary):

    xx = S' + 2 kappa S,   xu = S,   ux = -omega^2 S,   uu = S',
    xk = int_0^h S(h - s) (s/h)^k ds for k = 0 ... 3,   uk = int_0^h S'(h - s) (s/h)^k ds
"""

from mpmath import cosh, exp, mp, mpf, nstr, quad, re, sinh, sqrt, workdps

mp.dps = 300


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
    x, u = [], []
    for k in range(4):
        # uk by parts; xk from the equation of motion at h, or from its integral where there is no restoring force
        u.append(k * x[k - 1] / h if k > 0 else s)
        du = k * u[k - 1] / h if k > 0 else ds
        if omega != 0:
            x.append((1 - 2 * kappa * u[k] - du) / omega**2)
        elif kappa != 0:
            x.append((h / (k + 1) - u[k]) / (2 * kappa))
        else:
            x.append(h * h / ((k + 1) * (k + 2)))
    if 1e-3 < (omega + kappa) * h < 20:  # the integrals themselves, where they are easy
        with workdps(40):
            for k in range(4):
                for part, found in ((0, x[k]), (1, u[k])):
                    check = quad(lambda t: impulse_response(omega, kappa, h - t)[part] * (t / h) ** k, [0, h / 2, h])
                    assert abs(check - found) < 1e-25 * h ** (2 - part), (omega, kappa, h, k)
    return ds + 2 * kappa * s, s, -omega**2 * s, ds, *x, *u


def main():
    eps = 2.0**-52
    ratios = [0.0, 1e-3, 0.1, 0.7, 1 - 1e-3, 1 - 1e-9, 1 - eps, 1.0, 1 + eps, 1 + 1e-9, 1 + 1e-3, 1.5, 3.0, 100.0, 1e6]
    phases = [1e-8, 1e-6, 1e-4, 1e-2, 0.2, 0.45, 0.7, 1.0, 2.5, 4.0, 10.0, 100.0, 1e3, 1e4, 1e6, 1e8]
    rows = [(phase * 60.0, ratio * phase * 60.0, 1 / 60) for ratio in ratios for phase in phases]
    # no restoring force, no force at all
    rows += [(0.0, kappa, 0.01) for kappa in (0.0, 1e-6, 1e-2, 1.0, 60.0, 1e4, 1e10)]
    # both sides of where the implementation changes its formula, and other steps than 1/60
    for h in (1e-6, 1.0, 1e3):
        rows += [(x / h, y / h, h) for x, y in (
            (0.5, 0.499), (0.5, 0.501), (0.334, 0.665), (0.334, 0.667), (0.33, 0.66), (1.0, 1.9999), (1.0, 2.0),
            (1e-4, 0.999), (1e-4, 1.49), (1e-4, 1.51), (0.7, 1.3), (0.61, 1.2), (2.9, 0.04), (2.99, 0.0), (3.01, 0.0), (1e-3, 3.0), (1.0, 1 + eps), (1.0, 1.1), (1.0, 1.2), (9.9e-5, 0.0), (1.01e-4, 0.0),
        )]
    print("omega,kappa,h,xx,xu,ux,uu,x0,x1,x2,x3,u0,u1,u2,u3")
    for omega, kappa, h in rows:
        results = propagator(mpf(omega), mpf(kappa), mpf(h))
        print(",".join([repr(x) for x in (omega, kappa, h)] + [nstr(x, 17, min_fixed=0, max_fixed=0) for x in results]))


if __name__ == "__main__":
    main()

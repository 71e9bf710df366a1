//! Compares every operation, lane by lane, on every instruction set of this machine, with the scalar operation.

use pulp::{Arch, Simd, WithSimd};

use super::{LANES, Mask, Reals, Vector};
use crate::sim::numerics::arrays::Vectors;

/// Numbers at which instruction sets might differ: zeros, all magnitudes, subnormals, infinities and NaN.
const NUMBERS: [f64; 20] = [
    0.0,
    -0.0,
    1.0,
    -1.5,
    std::f64::consts::PI,
    1.0 + f64::EPSILON,
    1.0 / 3.0,
    -2.0 / 3.0,
    5e-324,
    -5e-324,
    1e-310,
    -3e-309,
    f64::MIN_POSITIVE,
    1.5e-162,
    7e153,
    f64::MAX,
    f64::MIN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    f64::NAN,
];

type Lanes = [f64; LANES];

/// The result of each operation.
type Results = Vec<(&'static str, Lanes)>;

/// All operations on these lanes, `W` registers at a time.
struct Every<'a, const W: usize> {
    a: &'a Lanes,
    b: &'a Lanes,
    c: &'a Lanes,
}

impl<const W: usize> WithSimd for Every<'_, W> {
    type Output = Results;

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) -> Results {
        let mut results: Results = vec![];
        let count = Reals::<S, W>::COUNT;
        for first in (0..LANES).step_by(count) {
            let [a, b, c] = [self.a, self.b, self.c].map(|lanes| Reals::<S, W>::load(simd, lanes, first));
            let mut put = |name: &'static str, value: Reals<S, W>| {
                if first == 0 {
                    results.push((name, [0.0; LANES]));
                }
                let (_, lanes) = results.iter_mut().find(|(other, _)| *other == name).unwrap();
                value.store(lanes, first);
            };
            let (one, zero) = (Reals::splat(simd, 1.0), Reals::splat(simd, 0.0));
            put("load", a);
            put("splat", Reals::splat(simd, self.b[0]));
            put("+", a + b);
            put("-", a - b);
            put("*", a * b);
            put("* number", a * self.b[0]);
            put("sqrt", a.sqrt());
            put("abs", a.abs());
            put("larger", a.larger(b));
            put("larger_or_nan", a.larger_or_nan(b));
            put("smaller", a.smaller(b));
            put("below", a.below(b).select(one, zero));
            put("at_most", a.at_most(b).select(one, zero));
            put("negated", a.below(b).negated().select(one, zero));
            put("or", a.below(b).or(b.below(c)).select(one, zero));
            put("none", Mask::none(simd).select(one, zero));
            put("select", a.below(b).select(b, c));
            put("any", if a.below(b).any() { one } else { zero });
            put("any of none", if Mask::<S, W>::none(simd).any() { one } else { zero });

            let (v, w) = (Vector { x: a, y: b, z: c }, Vector { x: c, y: a, z: b });
            let mut put_vector = |names: [&'static str; 3], v: Vector<S, W>| {
                put(names[0], v.x);
                put(names[1], v.y);
                put(names[2], v.z);
            };
            put_vector(["v+.x", "v+.y", "v+.z"], v + w);
            put_vector(["v-.x", "v-.y", "v-.z"], v - w);
            put_vector(["v*.x", "v*.y", "v*.z"], v * b);
            put_vector(["vs.x", "vs.y", "vs.z"], a.below(b).select_vector(v, w));
            put("|v|²", v.length_squared());
            put("v·w", v.dot(w));
        }
        results
    }
}

/// The expected results, computed one number at a time; `together` is the number of lanes that `any` reduces.
fn expected(a: &Lanes, b: &Lanes, c: &Lanes, name: &str, together: usize) -> Lanes {
    let flag = |yes: bool| f64::from(u8::from(yes));
    std::array::from_fn(|i| {
        let (x, y, z) = (a[i], b[i], c[i]);
        let group = i / together * together..(i / together + 1) * together;
        match name {
            "load" => x,
            "splat" => b[0],
            "+" => x + y,
            "-" => x - y,
            "*" | "v*.x" => x * y,
            "* number" => x * b[0],
            "sqrt" => x.sqrt(),
            "abs" => x.abs(),
            "larger" => {
                if x < y {
                    y
                } else {
                    x
                }
            }
            "larger_or_nan" => {
                if x < y || y.is_nan() {
                    y
                } else {
                    x
                }
            }
            "smaller" => {
                if y < x {
                    y
                } else {
                    x
                }
            }
            "below" => flag(x < y),
            "at_most" => flag(x <= y),
            "negated" => flag(!(x < y)),
            "or" => flag(x < y || y < z),
            "none" | "any of none" => 0.0,
            "select" => {
                if x < y {
                    y
                } else {
                    z
                }
            }
            "any" => flag(group.into_iter().any(|i| a[i] < b[i])),
            "v+.x" => x + z,
            "v+.y" => y + x,
            "v+.z" => z + y,
            "v-.x" => x - z,
            "v-.y" => y - x,
            "v-.z" => z - y,
            "v*.y" => y * y,
            "v*.z" => z * y,
            "vs.x" => {
                if x < y {
                    x
                } else {
                    z
                }
            }
            "vs.y" => {
                if x < y {
                    y
                } else {
                    x
                }
            }
            "vs.z" => {
                if x < y {
                    z
                } else {
                    y
                }
            }
            "|v|²" => x * x + y * y + z * z,
            "v·w" => x * z + y * x + z * y,
            _ => panic!("{name} is not expected"),
        }
    })
}

#[cfg(target_arch = "x86_64")]
fn instruction_sets() -> Vec<(&'static str, Arch, usize)> {
    let v3 = pulp::x86::V3::try_new().map(|v3| ("AVX2", Arch::V3(v3), 4));
    let v4 = pulp::x86::V4::try_new().map(|v4| ("AVX-512", Arch::V4(v4), 8));
    [Some(("SSE2", Arch::Scalar, 1)), v3, v4].into_iter().flatten().collect()
}

#[cfg(not(target_arch = "x86_64"))]
fn instruction_sets() -> Vec<(&'static str, Arch, usize)> {
    vec![("scalar", Arch::Scalar, 1)]
}

/// Identical bits, or both NaN.
fn same(x: f64, y: f64) -> bool {
    x.to_bits() == y.to_bits() || x.is_nan() && y.is_nan()
}

fn check<const W: usize>(a: &Lanes, b: &Lanes, c: &Lanes) {
    for (set, arch, width) in instruction_sets() {
        let results = arch.dispatch(Every::<W> { a, b, c });
        assert_eq!(results.len(), 19 + 12 + 2);
        for (name, lanes) in results {
            let expected = expected(a, b, c, name, W * width);
            for i in 0..LANES {
                assert!(
                    same(lanes[i], expected[i]),
                    "{set}, {W} registers, lane {i}: {name} of {:e}, {:e}, {:e} is {:e}, not {:e}",
                    a[i],
                    b[i],
                    c[i],
                    lanes[i],
                    expected[i]
                );
            }
        }
    }
}

#[test]
fn every_operation_equals_the_scalar_one_in_each_lane() {
    // all pairs of numbers, in varying positions
    let n = NUMBERS.len();
    for shift in 0..n {
        for start in 0..n {
            let at = |offset: usize| std::array::from_fn(|i| NUMBERS[(start + offset + i) % n]);
            let (a, b, c): (Lanes, Lanes, Lanes) = (at(0), at(shift), at(2 * shift + 7));
            check::<1>(&a, &b, &c);
            check::<2>(&a, &b, &c);
        }
    }
}

#[test]
fn vectors_are_loaded_from_their_place() {
    struct Double<'a>(&'a mut Vectors);
    impl WithSimd for Double<'_> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for first in (0..self.0.len()).step_by(Reals::<S, 2>::COUNT) {
                let Vector { x, y, z } = Vector::<S, 2>::load(simd, self.0, first) * 2.0;
                x.store(&mut self.0.x, first);
                y.store(&mut self.0.y, first);
                z.store(&mut self.0.z, first);
            }
        }
    }
    for (set, arch, _) in instruction_sets() {
        let vector = |i: usize| glam::DVec3::new(i as f64, 100.0 + i as f64, -(i as f64));
        let mut vectors: Vectors = (0..3 * LANES).map(vector).collect();
        arch.dispatch(Double(&mut vectors));
        assert!(vectors.iter().enumerate().all(|(i, v)| v == 2.0 * vector(i)), "{set}");
    }
}

//! A short slice of the stress sweep of `bench stability`.

use meldscope::{
    bench::stability::{self, Settings, cases::Case},
    scene::Integrator,
};

fn sweep(cases: u64, integrator: Integrator) -> Vec<stability::Row> {
    let settings = Settings { cases, integrators: vec![integrator], most_steps: 2_000 };
    stability::sweep(&settings, &|_| ()).expect("every case is a valid scene that fits")
}

/// The first 100 cases have every axis of the sweep among them.
#[test]
fn exponential_passes_every_case() {
    for row in sweep(100, Integrator::Exponential) {
        for outcome in &row.outcomes {
            assert_eq!(outcome.failure, None, "{outcome:?}");
        }
    }
}

/// Failures are found and shown: explicit schemes do not survive the stiff cases.
#[test]
fn explicit_schemes_fail_where_they_must() {
    for integrator in [Integrator::Thesis, Integrator::Rk4] {
        let rows = sweep(100, integrator);
        let failed = rows.iter().flat_map(|row| &row.outcomes).filter(|outcome| outcome.failure.is_some()).count();
        assert!(failed > 10, "{integrator}: {failed}");
    }
}

/// A case is a function of its number.
#[test]
fn cases_are_the_same_every_time() {
    for index in 0..200 {
        let [a, b] = [0, 1].map(|_| Case::new(index).expect("a valid scene").scene.source);
        assert_eq!(a, b, "case {index}");
    }
}

//! The checksum depends on every bit of the state and not on how the state is stored.

use super::*;
use crate::scene::Scene;
use crate::sim::{
    World,
    numerics::arrays::{Block, Blocks},
    prescribed::Prescribed,
    solver::Solver,
};

fn prescribed(world: &mut World) -> &mut Prescribed {
    let Solver::Prescribed(prescribed) = &mut world.solver else { unreachable!("all bodies are on paths") };
    prescribed
}

/// Two merged bodies, each with at least one vertex near the other's sphere and other vertices free.
fn merged() -> World {
    let mut world = World::new(Scene::builtin("two").unwrap()).unwrap();
    for _ in 0..120 {
        let _ = world.step();
    }
    assert!(prescribed(&mut world).actives.all_mut().iter().all(|active| !active.state.deformation.is_empty()));
    world
}

/// One coordinate of the displacements or velocities of a body: six of the active set, six of the free vertices.
fn axis(active: &mut Active, number: usize) -> Vec<&mut f64> {
    fn of<const V: usize>(blocks: &mut Blocks<V>, v: usize, axis: usize, count: usize) -> Vec<&mut f64> {
        blocks.all_mut().iter_mut().flat_map(|block| &mut block.0[v][axis]).take(count).collect()
    }
    let Deformation { active_set, free_vertices } = &mut active.state.deformation;
    if number < 6 {
        of(&mut active_set.blocks, number / 3, number % 3, active_set.vertices.len())
    } else {
        of(&mut free_vertices.blocks, (number - 6) / 3, number % 3, free_vertices.vertices.len())
    }
}

#[test]
fn every_bit_of_the_state_counts() {
    let mut world = merged();
    let before = world.checksum();
    for slot in 0..prescribed(&mut world).actives.all_mut().len() {
        for number in 0..12 {
            for i in 0..axis(&mut prescribed(&mut world).actives.all_mut()[slot], number).len() {
                let is_zero = *axis(&mut prescribed(&mut world).actives.all_mut()[slot], number)[i] == 0.0;
                for bit in [0, 1, 31, 32, 51, 52, 62, 63].into_iter().filter(|&bit| !(is_zero && bit == 63)) {
                    let flip = |world: &mut World| {
                        let value = &mut *axis(&mut prescribed(world).actives.all_mut()[slot], number)[i];
                        *value = f64::from_bits(value.to_bits() ^ 1 << bit);
                        world.checksum()
                    };
                    assert_ne!(flip(&mut world), before, "body {slot}, axis {number}, number {i}, bit {bit}");
                    assert_eq!(flip(&mut world), before);
                }
            }
        }
        let flip = |world: &mut World| {
            prescribed(world).actives.all_mut()[slot].state.carried.u.y += 1.0;
            world.checksum()
        };
        assert_ne!(flip(&mut world), before);
        world = merged();
    }
    world.step += 1;
    assert_ne!(world.checksum(), before);
}

/// Changes that come in pairs, as in a symmetric motion, do not cancel.
#[test]
fn pairs_of_changes_count() {
    let mut world = merged();
    let before = world.checksum();
    let numbers: Vec<f64> =
        axis(&mut prescribed(&mut world).actives.all_mut()[0], 0).into_iter().map(|number| *number).collect();
    let count = numbers.len();
    let mut seen = std::collections::HashSet::from([before]);
    for i in 0..count {
        for j in (0..i).filter(|&j| numbers[i] != 0.0 && numbers[j] != 0.0) {
            let (a, b) = (numbers[i], numbers[j]);
            let mut changes =
                vec![(-a, -b), (b, a), (a.next_up(), b.next_down()), (a.next_up(), b.next_up()), (2.0 * a, 2.0 * b)];
            changes.retain(|change| *change != (a, b));
            changes.dedup(); // where one is the negative of the other
            for changed in changes {
                let set = |world: &mut World, (a, b)| {
                    let mut axis = axis(&mut prescribed(world).actives.all_mut()[0], 0);
                    (*axis[i], *axis[j]) = (a, b);
                };
                set(&mut world, changed);
                assert!(seen.insert(world.checksum()), "vertices {i} and {j}: {changed:?} for {:?}", (a, b));
                set(&mut world, (a, b));
            }
        }
    }
    assert_eq!(world.checksum(), before);
}

#[test]
fn padding_does_not_count() {
    let mut world = merged();
    let before = world.checksum();
    let active_set = &mut prescribed(&mut world).actives.all_mut()[0].state.deformation.active_set;
    let count = active_set.vertices.len();
    let Block([_, velocity, _]) = active_set.blocks.all_mut().last_mut().unwrap();
    assert!(!count.is_multiple_of(LANES));
    velocity[2][count % LANES..].fill(f64::NAN);
    assert_eq!(world.checksum(), before);
}

#[test]
fn phases_count() {
    let mut world = merged();
    let before = world.checksum();
    let none = crate::sim::prescribed::pairs::Pairs::new(world.scene());
    prescribed(&mut world).pairs = none;
    assert_ne!(world.checksum(), before);
}

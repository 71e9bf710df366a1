//! Work on the items of a slice, on several threads or on one.

use rayon::prelude::*;

/// Collects what `map` finds for each item.
pub fn collect<T: Sync, R: Send, C: FromIterator<R> + FromParallelIterator<R>>(
    is_parallel: bool,
    items: &[T],
    map: impl Fn(&T) -> R + Sync + Send,
) -> C {
    if is_parallel { items.par_iter().map(map).collect() } else { items.iter().map(map).collect() }
}

/// Calls `work` with the index of each item and the item.
pub fn over<T: Send>(is_parallel: bool, items: &mut [T], work: impl Fn(usize, &mut T) + Sync + Send) {
    if is_parallel {
        items.par_iter_mut().enumerate().for_each(|(index, item)| work(index, item));
    } else {
        items.iter_mut().enumerate().for_each(|(index, item)| work(index, item));
    }
}

//! Sweeps: one run for every point of a grid over a scene's parameters, and the map of their outcomes.
//!
//! | contents | module |
//! | --- | --- |
//! | the sweep file | [`file`] |
//! | the points and their row numbers | [`design`] |
//! | one run: its outcome, its measures, its end; that of another experiment | [`run`], `own` |
//! | the columns of a row | [`row`] |
//! | the outcomes of runs as small numbers | [`classes`] |
//! | rows read back from Parquet | [`table`] |
//! | the folder: finished and unfinished rows | [`store`] |
//! | the runs of a level, on all cores | [`level`] |
//! | refinement of the grid | [`refine`] |
//! | thresholds along one axis | [`bisect`] |
//! | the map: regions and boundaries | [`map`] |
//! | the map as SVG, and as a recording | [`svg`], [`picture`] |
//! | built-in sweeps | [`builtin`] |
//!
//! # The sweep file
//! ```toml
//! scene = "collide"             # a file in the same folder, or a built-in scene
//! until = "certain"             # certain | end: when a run ends [certain]; see [`run`]
//! measures = ["displacement"]   # displacement, surfaces: optional measures, which take time [none]
//! color = "outcome"             # the column by which the map is coloured [outcome]
//!
//! [jump]                        # --refine also halves the grid where neighbours differ by more than this [none]
//! first_merge = 0.05            # closest, time_merged, first_merge, first_split, merges, splits, energy_by_events or
//! max_displacement = 0.2        # max_displacement, in the units of their columns
//!
//! [[axis]]                      # up to 8
//! key = "influence.merge_at"    # a path into the scene; bodies by name: body.left.motion.free.velocity[0]
//! from = 0.8
//! to = 1.15
//! count = 41
//! scale = "linear"              # linear | log [linear]
//! name = "merge_at"             # its name on the map [the key]
//!
//! [[axis]]
//! key = "influence.scaling"
//! values = ["relative", "absolute"]     # or numbers
//!
//! [[set]]                       # the same in all runs
//! key = "body.right.motion.free.velocity[0]"
//! value = 0.0
//! ```
//!
//! With `sample = "latin"` or `"sobol"`, `count` and `seed` [0] are at the top of the sweep, not in its axes.
//!
//! # Other experiments
//! In a program of its own ([`cli::run`](crate::cli::run)), `scene` is the name of an experiment, keys are those of its
//! [parameters](crate::observe::Experiment::parameters), and the outcome of a run is the kinds of its events, in order:
//! `grip slip`, or `none`. `until`, `measures`, `color`, `[jump]` and `--open` are for scenes.
//!
//! # Rows
//! The columns of the tables are described in their schema, and listed in [`row::columns`]. All except `run_time`
//! depend only on the sweep: they are bit-identical on any machine, for any number of threads, shards and
//! interruptions.
//!
//! # On several machines
//! Machines that share the folder `DIR` run one level at a time, each a part of it. The command without `--shard` then
//! draws the map.
//!
//! ```sh
//! #SBATCH --array=0-63                                            # Slurm
//! #SBATCH --cpus-per-task=1
//! meldscope sweep mine.toml --out DIR --refine 5 --shard $SLURM_ARRAY_TASK_ID/64 --level 0 --threads 1
//!
//! # Kubernetes, in the spec of a Job: completionMode Indexed, completions 64
//! meldscope sweep mine.toml --out DIR --refine 5 --shard $JOB_COMPLETION_INDEX/64 --level 0 --threads 1
//!
//! for level in 0 1 2 3 4 5; do                                    # GNU parallel
//!   seq 0 63 | parallel -S node1,node2 --wd . \
//!     meldscope sweep mine.toml --out DIR --refine 5 --shard {}/64 --level $level --threads 1
//! done
//! ```
//!
//! `python3 src/sweep/on_ray.py mine.toml --out DIR --refine 5` runs all levels on a Ray cluster and retries lost
//! shards.

pub mod bisect;
pub mod builtin;
pub mod classes;
pub mod design;
pub mod file;
pub mod level;
pub mod map;
mod own;
pub mod picture;
pub mod refine;
pub mod row;
pub mod run;
pub mod store;
pub mod svg;
pub mod table;

pub use file::Sweep;

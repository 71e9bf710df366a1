//! Frames as Rerun data: a recording that the viewer opens, or that it follows live.
//!
//! | what | where |
//! | --- | --- |
//! | a recording from its first message to its last | [`recorder`] |
//! | recording on a thread of its own | [`pipeline`] |
//! | which entities there are, and what is logged to each | [`parts`] |
//! | what a step leaves to be recorded | [`step`] |
//! | the state as meshes and arrows, in the viewer's precision | [`extract`] |
//! | smooth normals of deformed surfaces | [`normals`] |
//! | what a recording is a function of | [`settings`] |
//! | lines of plots | [`series`] |
//! | a hash of the state for every step | [`checksums`] |
//! | the last frames, kept until something happens | `flight` |
//! | where a recording was made | [`machine`] |
//! | when rows are | [`instant`] |
//! | rows gathered into chunks, chunks into messages | [`chunks`], in [`columns`] what comes frame after frame |
//! | the layout that the viewer opens with | [`blueprint`] |
//! | colours and what they mean | [`palette`] |
//! | where the messages go: files, viewers, servers | [`sinks`] |
//!
//! Nothing here knows what is simulated, or how: see [`observe`](crate::observe).
//!
//! # What a recording holds
//! Two timelines, `step` and `sim_time`, and these entities. A value that did not change is not logged again. Equal runs give
//! equal recordings but for `/timings`, the ranges that the layout has for their plots, and the machine's name.
//!
//! | entity | what |
//! | --- | --- |
//! | `/world/bodies/NAME`, `…/surface` | transform to the centre; mesh in body coordinates |
//! | `/world/resting/SHAPE`, `/world/deforming/surface` | instead, for more than 64 bodies: undeformed ones as instances, the others as one mesh in world coordinates |
//! | `/world/influence` | every influence sphere |
//! | `/world/pairs` | lines between the centres of pairs within reach, the closest 16, or 5 of a batched scene (`--pairs N`), labelled with q; in a batched scene also the influence spheres that reach somebody |
//! | `/world/forces/CAUSE` | arrows of `attraction`, `repulsion` (of bodies apart), `core` (of bodies in their core), `restoring`, `damping`, `push`, `carry`, `net`: accelerations times the arrow scale that the panel states; classes, named at `/world/forces`, say between which two bodies one acts |
//! | on a surface, with forces | of each vertex: `body`, `vertex`, `displacement_in_radii`, `net_force`, `reach`, and its colour in the heat map |
//! | `/pairs/A~B/distance`, `…/merge_at`, `…/split_at`, `…/core_at`, `…/phase` | q, its thresholds, the phase, for the first 16 pairs within reach, or 5 in a batched scene (`--pairs N`), of those that come together the closest |
//! | `/events` | a line for each merge, split and core event, and beside it, as components, `bodies`, `phases` (before and after), `time` (s, exact) and `q` |
//! | `/timings/STAGE`, `/timings/speed`, `/timings/lag`, `/diagnostics/…` | numbers over time |
//! | `/stages` | on the timeline `stage`: a line for each stage of the steps that are looked into; the entities under `/world` are there, too |
//! | `/checksum` | `checksum`, a hash of the exact state, for every step; in a thin recording several steps a row, the last of which is the row's |
//! | `/about` | the text of the panel |
//! | properties `meldscope` | the scene's text, the resolved settings, what they change of the scene (`overrides`), program version, format, machine, integrator, number of steps, a digest of all checksums |

pub mod blueprint;
pub mod checksums;
pub mod chunks;
pub mod columns;
pub mod extract;
mod flight;
pub mod instant;
pub mod machine;
pub mod normals;
pub mod palette;
pub mod parts;
pub mod pipeline;
pub mod recorder;
pub mod series;
pub mod settings;
pub mod sinks;
pub mod step;

pub use pipeline::Pipeline;
pub use recorder::Recorder;
pub use settings::Settings;

//! Recording of a simulation as Rerun data, for a file or a live viewer.
//!
//! | contents | module |
//! | --- | --- |
//! | recording of a whole run | [`mod@record`] |
//! | a recording from its first message to its last | [`recorder`] |
//! | recording on a separate thread | [`pipeline`] |
//! | the entities of a frame, and what is logged to each | [`parts`] |
//! | the data of a step to be recorded | [`step`] |
//! | states as meshes and arrows, in the precision of the viewer | [`extract`] |
//! | smooth normals of deformed surfaces | [`normals`] |
//! | the settings that determine a recording | [`settings`] |
//! | prediction of the size of a recording | [`size`] |
//! | plot lines | [`series`] |
//! | a hash of the state for every step | [`checksums`] |
//! | the last frames, kept until a trigger fires | `flight` |
//! | the machine on which a recording was made | [`machine`] |
//! | time points of rows | [`instant`] |
//! | batching of rows into chunks and messages | [`chunks`]; [`columns`] for what is logged every frame |
//! | the layout that the viewer opens with | [`blueprint`] |
//! | colours and their meaning | [`palette`] |
//! | the light on surfaces | [`light`] |
//! | destinations of messages: files, viewers, servers | [`sinks`] |
//!
//! Nothing here depends on a particular simulation: see [`observe`](crate::observe).
//!
//! # Contents of a recording
//! A recording has two timelines, `step` and `sim_time`, and the entities below. Unchanged values are not logged again.
//! Equal runs give equal recordings except for `/timings`, the axis ranges of their plots in the layout, and the name
//! of the machine.
//!
//! | entity | contents |
//! | --- | --- |
//! | `/world/bodies/NAME`, `…/surface` | transform to the centre; mesh in body coordinates |
//! | `/world/resting/SHAPE`, `/world/deforming/surface` | replace the above for more than 64 bodies: undeformed ones as instances, the others as one mesh in world coordinates |
//! | `/world/merged/surface`, `…/seams` | the surfaces of all groups (two or more bodies connected by joined pairs) as one mesh in world coordinates, with class ids that name the body of each vertex and `vertex`, its index there; the lines along which bodies meet. A body in a group keeps its own surface, but its component `drawn_triangles`, which the layout draws, is one degenerate triangle |
//! | `/groups/A/volume`, `…/genus`, `…/bodies`, with few bodies also `…/area`, `…/components`, `…/euler` | volume, genus, number of bodies, area, connected components and Euler characteristic of the sharp union of the group whose first body is A; as many groups as pairs with plots. `/diagnostics/overlapping_groups`: the number of groups that could not be united in time and are drawn as overlapping meshes |
//! | `/world/influence` | all influence spheres |
//! | `/world/pairs` | lines between the centres of pairs within reach, labelled with q: the closest 16, or 5 in a batched scene (`--pairs N`); in a batched scene also the influence spheres that reach another body |
//! | `/world/forces/CAUSE` | arrows of `attraction`, `repulsion` (of bodies apart), `core` (of bodies in their core), `point` (of force points), `restoring`, `damping`, `push`, `carry`, `net`: accelerations times the arrow scale given in the panel; classes, named at `/world/forces`, identify the two bodies between which a force acts |
//! | `/world/forces/net_force`, `…/torque` | one arrow per free body, at its centre: force over mass, torque over mass times radius, times the scale given in the panel |
//! | `/world/trails` | the path of the centre of each free body, one segment per frame; not in a batched scene |
//! | `/world/planes/N`, `…/grid` | planes |
//! | on a surface, with forces | for each vertex: `body`, `vertex`, `displacement_in_radii`, `net_force`, `reach` |
//! | `/pairs/A~B/distance`, `…/merge_at`, `…/split_at`, `…/core_at`, `…/phase` | q, its thresholds and the phase, for the first 16 pairs within reach, or 5 in a batched scene (`--pairs N`), and as many that have events; of pairs that come within reach together, the closest (`--pair A~B`: that pair alone) |
//! | `/pairs/A~B/gap`, `…/overlap`, `…/neck`, `…/contact` | for the same pairs: smallest distance between the surfaces or minus the penetration depth, volume of the intersection, radius of the seam (in radii of the smaller body); where these and the phase disagree |
//! | `/events` | one line per merge, split and core event, with the components `bodies`, `phases` (before and after), `time` (s, exact), `q` and its `rate` (1/s); with free bodies also the `energy` that they gained |
//! | `/events/accuracy` | one line per step in which the error of a body exceeds the tolerance: which body, and by how much |
//! | `/events/surfaces` | one line when surfaces touch or part; a thin recording has it in `/events` |
//! | `/events/bodies` | one line per cell of a body that was cut, or would have torn, and per node that was split, with its position |
//! | `/timings/STAGE`, `/timings/stacked/STAGE`, `/timings/speed`, `/timings/lag`, `/diagnostics/…` | scalars over time; `stacked`: with the stages before it on the same thread |
//! | `/marks/axis/KIND`, `/marks/q/KIND` | events as markers in plots: at 0, and at q |
//! | `/world/names`, `/world/recent` | the names of up to 8 bodies; pairs that had an event in the last 24 frames |
//! | `/legend/…` | the colour scale of the displacement tab; `heat_…` on a surface: its texture and texture coordinates |
//! | `lit_colors`, `unlit_normals` on a surface | colours with baked lighting, which the layout draws without the viewer's lights |
//! | `/stages` | on the timeline `stage`: one line per stage of the steps recorded in detail; the entities under `/world` have this timeline too |
//! | `/checksum` | `checksum`, a hash of the exact state, for every step; a thin recording has several steps per row, at the time of the last one |
//! | `/about` | the text of the panel |
//! | properties `meldscope` | text of the scene, resolved settings, overrides of the scene's own (`overrides`), program version, format, machine, integrator, number of steps, digest of all checksums |

pub mod blueprint;
pub mod checksums;
pub mod chunks;
pub mod columns;
pub mod extract;
mod flight;
mod focus;
pub mod instant;
pub mod light;
pub mod machine;
pub mod normals;
pub mod palette;
pub mod parts;
pub mod pipeline;
pub mod record;
pub mod recorder;
pub mod series;
pub mod settings;
pub mod sinks;
pub mod size;
pub mod step;

pub use pipeline::Pipeline;
pub use record::{RecordError, record};
pub use recorder::Recorder;
pub use settings::Settings;

//! Integration tests of the library and the program, in one binary.

mod bad_recordings;
mod bad_scenes;
mod bench;
mod checksums;
mod cli;
mod events;
mod faults;
mod files;
mod free_bodies;
mod integrators;
mod octahedra;
mod physics;
mod recording;
mod reference;
mod replay;
mod rims;
mod scale;
mod scene_format;
mod serving;
mod sinks;
mod skipping;
mod stability;
mod stranger;
mod sweep;
mod tolerance;
mod work;

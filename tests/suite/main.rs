//! The laws that qtracer keeps, one module per floor or claim. One binary, so that it links once.
//!
//! Seeds are fixed: a test that passes keeps passing until the code changes. Where a test is statistical it says its
//! error rate α, the chance that a right program would have failed it at a seed drawn at random. Every comparator has a
//! negative control, which must fail.
//!
//! Tests of the GPU fail, and do not skip, where there is no adapter: `tests/run` installs a software one.

mod bench_report;
mod energy;
mod engines;
mod environment;
mod extremes;
mod failing_images;
mod films;
mod floors;
mod furnace;
mod guiding_kernels;
mod guiding_maths;
mod guiding_renders;
mod guiding_samplers;
mod instances;
mod kernels;
mod lost_samples;
mod many_lights;
mod models;
mod oracles;
mod placement;
mod probe;
mod queues;
mod recorded_levels;
mod references;
mod rooms;
mod samplers;
mod shapes;
mod splitting;
mod stage_twins;
mod support;
mod surfaces;
mod tables;
mod triangles;

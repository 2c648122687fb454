//! What is right, worked out in double precision: what the laws compare the program's single precision with.

pub mod geometry;

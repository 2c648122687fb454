//! Models: what glTF files mean, alone and in scenes, and that no file makes the reader panic. Files are made here, from JSON and
//! bytes.

mod accessors;
pub mod builder;
mod chess;
mod hostile;
mod materials;
mod textures;
mod transforms;
mod views;

//! The GPU: which kernels a scene needs, their linking, the device, its buffers, its clock.

pub mod buffers;
pub mod device;
pub mod error;
pub mod kernel;
pub mod key;
pub mod link;
pub mod stage;

//! Buffers by the name that the kernels call them. Only what some kernel binds is ever made.

use super::device::Gpu;
use super::error::GpuError;
use std::collections::BTreeMap;
use wgpu::BufferUsages;

#[derive(Debug, Default)]
pub struct Buffers {
    by_name: BTreeMap<String, wgpu::Buffer>,
}

impl Buffers {
    /// A buffer of `size` bytes, refused with a clear error where the adapter can't bind it.
    pub fn create(&mut self, gpu: &Gpu, name: &str, size: u64, usage: BufferUsages) -> Result<(), GpuError> {
        let size = size.max(16).next_multiple_of(16);
        let limit = gpu.summary.max_binding.min(gpu.summary.max_buffer);
        if usage.contains(BufferUsages::STORAGE) && size > limit {
            return Err(GpuError::BufferTooLarge {
                adapter: gpu.summary.name.clone(),
                buffer: name.to_string(),
                bytes: size,
                limit,
            });
        }
        let buffer = gpu.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some(name),
            size,
            usage,
            mapped_at_creation: false,
        });
        self.by_name.insert(name.to_string(), buffer);
        gpu.check()
    }

    /// A storage buffer holding `data`.
    pub fn upload(
        &mut self,
        gpu: &Gpu,
        name: &str,
        data: &[u8],
        usage: BufferUsages,
    ) -> Result<(), GpuError> {
        self.create(gpu, name, data.len() as u64, usage | BufferUsages::COPY_DST)?;
        gpu.queue.write_buffer(self.get(name), 0, data);
        gpu.check()
    }

    /// The buffer of that name. Kernels and buffers are made from the same key, so a missing one is a bug.
    pub fn get(&self, name: &str) -> &wgpu::Buffer {
        &self.by_name[name]
    }

    /// Bytes of a buffer, None if it was never made.
    pub fn size(&self, name: &str) -> Option<u64> {
        self.by_name.get(name).map(wgpu::Buffer::size)
    }

    /// Bytes by name: what `--stats` shows and what tests assert.
    pub fn bytes(&self) -> BTreeMap<String, u64> {
        self.by_name.iter().map(|(name, buffer)| (name.clone(), buffer.size())).collect()
    }
}

//! Adapters, the device and its failures.

use super::error::GpuError;
use super::kernel::Kernel;
use std::sync::{Arc, LazyLock, Mutex};
use wgpu::{Adapter, DeviceType, Features};

/// What is known of a GPU before it is opened.
#[derive(Clone, Debug, serde::Serialize)]
pub struct AdapterSummary {
    pub name: String,
    pub driver: String,
    pub backend: String,
    /// A rasteriser on the CPU, such as lavapipe: right, but no faster than the CPU engine.
    pub software: bool,
    pub integrated: bool,
    /// Largest storage buffer binding, in bytes.
    pub max_binding: u64,
    /// Largest buffer, in bytes.
    pub max_buffer: u64,
    pub timestamps: bool,
}

/// An opened GPU. Errors that wgpu reports on its own are kept and returned by [`Gpu::check`], never a panic.
#[derive(Debug)]
pub struct Gpu {
    pub device: wgpu::Device,
    pub queue: wgpu::Queue,
    pub summary: AdapterSummary,
    failure: Arc<Mutex<Option<GpuError>>>,
}

/// One for the process: NVIDIA's driver gives no adapter any more after some 35 instances.
static INSTANCE: LazyLock<wgpu::Instance> = LazyLock::new(|| {
    let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle_from_env();
    // Indirect arguments are written and clamped by our own kernels; validating them took a prototype from 57 to 90 ms.
    descriptor.flags.remove(wgpu::InstanceFlags::VALIDATION_INDIRECT_CALL);
    wgpu::Instance::new(descriptor)
});

fn adapters() -> Vec<Adapter> {
    let mut adapters = pollster::block_on(INSTANCE.enumerate_adapters(wgpu::Backends::all()));
    adapters.retain(|a| a.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS));
    adapters.sort_by_key(|a| match a.get_info().device_type {
        DeviceType::DiscreteGpu => 0,
        DeviceType::VirtualGpu => 1,
        DeviceType::IntegratedGpu => 2,
        DeviceType::Other => 3,
        DeviceType::Cpu => 4,
    });
    adapters
}

fn summarize(adapter: &Adapter) -> AdapterSummary {
    let info = adapter.get_info();
    let limits = adapter.limits();
    AdapterSummary {
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_string(),
        backend: format!("{:?}", info.backend),
        software: info.device_type == DeviceType::Cpu,
        integrated: info.device_type == DeviceType::IntegratedGpu,
        max_binding: limits.max_storage_buffer_binding_size,
        max_buffer: limits.max_buffer_size,
        timestamps: adapter.features().contains(Features::TIMESTAMP_QUERY),
        name: info.name,
    }
}

/// Every adapter that can run compute kernels, the fastest kind first.
pub fn list_adapters() -> Vec<AdapterSummary> {
    adapters().iter().map(summarize).collect()
}

impl Gpu {
    /// Opens the first adapter whose name contains `name` (any case), or the first of all.
    pub fn open(name: Option<&str>) -> Result<Gpu, GpuError> {
        let all = adapters();
        let wanted = name.unwrap_or("").to_lowercase();
        let adapter =
            all.iter().find(|a| a.get_info().name.to_lowercase().contains(&wanted)).ok_or_else(|| {
                GpuError::NoAdapter {
                    wanted: name.map(str::to_string),
                    found: all.iter().map(|a| a.get_info().name).collect(),
                }
            })?;
        let summary = summarize(adapter);
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("qtracer"),
            required_features: adapter.features() & Features::TIMESTAMP_QUERY,
            required_limits: adapter.limits(),
            ..Default::default()
        };
        let (device, queue) = pollster::block_on(adapter.request_device(&descriptor))
            .map_err(|e| GpuError::Device { adapter: summary.name.clone(), reason: e.to_string() })?;
        let failure = Arc::new(Mutex::new(None));
        Gpu::watch(&device, &failure, &summary.name);
        Ok(Gpu { device, queue, summary, failure })
    }

    /// Keeps the first failure that the device reports by itself.
    fn watch(device: &wgpu::Device, failure: &Arc<Mutex<Option<GpuError>>>, adapter: &str) {
        let keep = |slot: &Arc<Mutex<Option<GpuError>>>, error: GpuError| {
            if let Ok(mut slot) = slot.lock() {
                slot.get_or_insert(error);
            }
        };
        let (slot, name) = (failure.clone(), adapter.to_string());
        device.on_uncaptured_error(Arc::new(move |error| {
            let reason = error.to_string();
            let adapter = name.clone();
            keep(
                &slot,
                match error {
                    wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory { adapter, reason },
                    _ => GpuError::Device { adapter, reason },
                },
            );
        }));
        let (slot, name) = (failure.clone(), adapter.to_string());
        device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                keep(&slot, GpuError::DeviceLost { adapter: name.clone(), reason: message });
            }
        });
    }

    /// The first failure since the last call, if any.
    pub fn check(&self) -> Result<(), GpuError> {
        match self.failure.lock().ok().and_then(|mut slot| slot.take()) {
            Some(error) => Err(error),
            None => Ok(()),
        }
    }

    /// Waits for everything submitted.
    pub fn wait(&self) -> Result<(), GpuError> {
        let waited = self.device.poll(wgpu::PollType::wait_indefinitely());
        self.check()?;
        waited
            .map(|_| ())
            .map_err(|e| GpuError::DeviceLost { adapter: self.summary.name.clone(), reason: e.to_string() })
    }

    /// Waits for one submission; later ones may go on.
    pub fn wait_for(&self, submission: wgpu::SubmissionIndex) -> Result<(), GpuError> {
        let waited =
            self.device.poll(wgpu::PollType::Wait { submission_index: Some(submission), timeout: None });
        self.check()?;
        waited
            .map(|_| ())
            .map_err(|e| GpuError::DeviceLost { adapter: self.summary.name.clone(), reason: e.to_string() })
    }

    /// Compiles a linked kernel.
    pub fn kernel(&self, name: &str, wgsl: &str) -> Result<Kernel, GpuError> {
        let kernel = Kernel::new(self, name, wgsl)?;
        self.check()?;
        Ok(kernel)
    }

    /// Copies `buffers` (each with its length in bytes) to the host. Waits.
    pub fn read(&self, buffers: &[(&wgpu::Buffer, u64)]) -> Result<Vec<Vec<u8>>, GpuError> {
        let mut encoder = self.device.create_command_encoder(&Default::default());
        let staging: Vec<wgpu::Buffer> = buffers
            .iter()
            .map(|&(buffer, size)| {
                let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("staging"),
                    size,
                    usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                });
                encoder.copy_buffer_to_buffer(buffer, 0, &staging, 0, size);
                staging
            })
            .collect();
        self.queue.submit([encoder.finish()]);
        for buffer in &staging {
            buffer.map_async(wgpu::MapMode::Read, .., |_| ());
        }
        self.wait()?;
        staging
            .iter()
            .map(|buffer| {
                let view = buffer.slice(..).get_mapped_range().map_err(|e| GpuError::DeviceLost {
                    adapter: self.summary.name.clone(),
                    reason: e.to_string(),
                })?;
                Ok(view.to_vec())
            })
            .collect()
    }
}

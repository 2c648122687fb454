//! A compiled kernel and what it binds: the bindings are read off the linked text, so nothing is bound that it does not use.

use super::buffers::Buffers;
use super::device::Gpu;
use super::error::GpuError;

#[derive(Debug)]
pub struct Kernel {
    pub name: String,
    pub pipeline: wgpu::ComputePipeline,
    /// (binding number, buffer name), all in group 0.
    pub bindings: Vec<(u32, String)>,
}

/// Parses and reflects one linked kernel: its entry point and its bindings.
pub fn reflect(name: &str, wgsl: &str) -> Result<(String, Vec<(u32, String)>), GpuError> {
    let invalid = |reason: String| GpuError::Kernel { kernel: name.to_string(), reason };
    let module =
        naga::front::wgsl::parse_str(wgsl).map_err(|e| invalid(e.emit_to_string_with_path(wgsl, name)))?;
    let entry = module.entry_points.first().ok_or_else(|| invalid("has no entry point".into()))?;
    let mut bindings: Vec<(u32, String)> = module
        .global_variables
        .iter()
        .filter_map(|(_, v)| Some((v.binding.as_ref()?.binding, v.name.clone()?)))
        .collect();
    bindings.sort();
    Ok((entry.name.clone(), bindings))
}

impl Kernel {
    pub fn new(gpu: &Gpu, name: &str, wgsl: &str) -> Result<Kernel, GpuError> {
        let (entry, bindings) = reflect(name, wgsl)?;
        let source =
            wgpu::ShaderModuleDescriptor { label: Some(name), source: wgpu::ShaderSource::Wgsl(wgsl.into()) };
        let checks = wgpu::ShaderRuntimeChecks { force_loop_bounding: false, ..Default::default() };
        // SAFETY: accesses stay checked; only naga's own loop counters are left out. The kernels' loops end by themselves:
        // they count up to lengths in the uniforms, or follow a path of at most `max_bounces` levels.
        let module = unsafe { gpu.device.create_shader_module_trusted(source, checks) };
        let pipeline = gpu.device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
            label: Some(name),
            layout: None,
            module: &module,
            entry_point: Some(&entry),
            compilation_options: Default::default(),
            cache: None,
        });
        Ok(Kernel { name: name.to_string(), pipeline, bindings })
    }

    /// Binds the buffers by name, with `renamed` (kernel's name → buffer's name) taking precedence, for ping-pong queues.
    pub fn bind(&self, gpu: &Gpu, buffers: &Buffers, renamed: &[(&str, &str)]) -> wgpu::BindGroup {
        let resolve = |name: &'_ str| -> String {
            renamed.iter().find(|(from, _)| *from == name).map_or(name, |(_, to)| to).to_string()
        };
        let entries: Vec<wgpu::BindGroupEntry> = self
            .bindings
            .iter()
            .map(|(binding, name)| wgpu::BindGroupEntry {
                binding: *binding,
                resource: buffers.get(&resolve(name)).as_entire_binding(),
            })
            .collect();
        gpu.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some(&self.name),
            layout: &self.pipeline.get_bind_group_layout(0),
            entries: &entries,
        })
    }
}

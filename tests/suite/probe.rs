//! Functions of the kernels by themselves: small kernels, linked from the program's own modules, answer arrays of questions
//! on the adapter under test.

use bytemuck::cast_slice;
use glam::{DVec3, Vec3};
use qtracer::gpu::buffers::Buffers;
use qtracer::gpu::device::Gpu;
use qtracer::gpu::kernel::Kernel;
use qtracer::gpu::key::KernelKey;
use qtracer::gpu::link::{MODULES, link_modules};
use qtracer::gpu::stage::{Schedule, Stage, WORKGROUP};
use qtracer::scene::rows::Row;
use wgpu::BufferUsages;

/// What a kernel binds besides questions and answers: name, bytes, kind.
pub type Input<'a> = (&'a str, &'a [u8], BufferUsages);

/// A kernel of one invocation per question: `body` sees its `Q` rows of words as `a`, `b` … and leaves its answer, `A` rows,
/// in `out0`, `out1` …
pub struct Probe<const Q: usize, const A: usize>(Kernel);

impl<const Q: usize, const A: usize> Probe<Q, A> {
    /// Linked in place of the `resolve` stage, which has no queues.
    pub fn new(gpu: &Gpu, key: &KernelKey, imports: &str, body: &str) -> Self {
        let names = ["a", "b", "c", "d"];
        let read = |i: usize| format!("let {} = questions[{Q}u * id.x + {i}u];\n", names[i]);
        let make = |i: usize| format!("var out{i} = vec4<u32>(0u);\n");
        let write = |i: usize| format!("answers[{A}u * id.x + {i}u] = out{i};\n");
        let [reads, outs, writes] =
            [(0..Q).map(read).collect(), (0..A).map(make).collect(), (0..A).map(write).collect::<String>()];
        let probe = format!(
            "{imports}
            import package::key::WORKGROUP;
            @group(0) @binding(60) var<storage, read> questions: array<vec4<u32>>;
            @group(0) @binding(61) var<storage, read_write> answers: array<vec4<u32>>;
            @compute @workgroup_size(WORKGROUP)
            fn probe_stage(@builtin(global_invocation_id) id: vec3<u32>) {{
                if {A}u * id.x >= arrayLength(&answers) {{ return; }}
                {reads} {outs} {body}
                {writes}
            }}"
        );
        let text = |&(name, text): &(&'static str, &'static str)| match name {
            "stages/resolve" => (name, probe.clone()),
            _ => (name, text.to_string()),
        };
        let modules: Vec<(&str, String)> = MODULES.iter().map(text).collect();
        let modules: Vec<(&str, &str)> = modules.iter().map(|(name, text)| (*name, text.as_str())).collect();
        let wgsl = link_modules(&modules, Stage::Resolve, key, Schedule::Fused).unwrap();
        Probe(gpu.kernel("probe", &wgsl).unwrap_or_else(|e| panic!("{e}\n{wgsl}")))
    }

    pub fn ask(&self, gpu: &Gpu, inputs: &[Input<'_>], questions: &[[Row; Q]]) -> Vec<[Row; A]> {
        let answers = vec![[Row::default(); A]; questions.len()];
        let mut buffers = Buffers::default();
        let storage = BufferUsages::STORAGE | BufferUsages::COPY_SRC;
        let own = [
            ("questions", cast_slice(questions.as_flattened()), storage),
            ("answers", cast_slice(answers.as_flattened()), storage),
        ];
        for (name, bytes, usage) in own.iter().chain(inputs) {
            buffers.upload(gpu, name, bytes, *usage).unwrap();
        }
        let bind = self.0.bind(gpu, &buffers, &[]);
        let mut encoder = gpu.device.create_command_encoder(&Default::default());
        {
            let mut pass = encoder.begin_compute_pass(&Default::default());
            pass.set_pipeline(&self.0.pipeline);
            pass.set_bind_group(0, &bind, &[]);
            pass.dispatch_workgroups((questions.len() as u32).div_ceil(WORKGROUP), 1, 1);
        }
        gpu.queue.submit([encoder.finish()]);
        let read = gpu.read(&[(buffers.get("answers"), (16 * A * questions.len()) as u64)]).unwrap();
        let rows: Vec<Row> = bytemuck::pod_collect_to_vec(&read[0]);
        rows.as_chunks().0.to_vec()
    }
}

/// A vector and a word as a row.
pub fn row(v: Vec3, word: u32) -> Row {
    [v.x.to_bits(), v.y.to_bits(), v.z.to_bits(), word]
}

/// The vector of a row, and its last word as a number.
pub fn floats(row: Row) -> (Vec3, f32) {
    let [x, y, z, w] = row.map(f32::from_bits);
    (Vec3::new(x, y, z), w)
}

/// Random numbers with all digits of an f64 (SplitMix64), the same in every run.
pub struct Numbers(pub u64);

impl Numbers {
    fn word(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.word() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Every order of magnitude as often as any other.
    pub fn of_any_size(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    pub fn below(&mut self, count: usize) -> usize {
        (self.word() % count as u64) as usize
    }

    pub fn in_box(&mut self, half: f64) -> DVec3 {
        DVec3::from_array([(); 3].map(|()| self.between(-half, half)))
    }

    pub fn sign(&mut self) -> f64 {
        [-1.0, 1.0][self.below(2)]
    }

    pub fn direction(&mut self) -> DVec3 {
        let (z, angle) = (self.between(-1.0, 1.0), self.between(0.0, std::f64::consts::TAU));
        let r = (1.0 - z * z).sqrt();
        DVec3::new(r * angle.cos(), r * angle.sin(), z)
    }
}

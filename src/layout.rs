//! Structs shared with the GPU, declared once: the Rust struct is the declaration, its WGSL text is generated from it,
//! and a test compares naga's offsets with Rust's (`tests/suite/kernels.rs`).

/// A Rust type that has a WGSL counterpart of the same size.
pub trait WgslType {
    /// Its name in WGSL.
    const NAME: &'static str;
}
impl WgslType for f32 {
    const NAME: &'static str = "f32";
}
impl WgslType for u32 {
    const NAME: &'static str = "u32";
}
impl WgslType for glam::Vec3 {
    const NAME: &'static str = "vec3<f32>";
}

impl WgslType for [f32; 3] {
    const NAME: &'static str = "array<f32, 3>";
}

/// One field of a shared struct.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    pub name: &'static str,
    pub wgsl_type: &'static str,
    /// Bytes from the start of the struct, in Rust.
    pub offset: usize,
}

/// A struct that lies in GPU buffers.
pub trait GpuStruct: bytemuck::Pod {
    const NAME: &'static str;
    const FIELDS: &'static [Field];

    /// The declaration for the kernels.
    fn wgsl() -> String {
        let fields: String =
            Self::FIELDS.iter().map(|f| format!("    {}: {},\n", f.name, f.wgsl_type)).collect();
        format!("struct {} {{\n{fields}}}\n", Self::NAME)
    }
}

/// Declares structs that exist in Rust and, under the same name and with the same layout, in the kernels. `vec3` fields
/// must start at multiples of 16 bytes, as WGSL asks.
#[macro_export]
macro_rules! gpu_struct {
    ($($(#[$doc:meta])* pub struct $name:ident { $($(#[$field_doc:meta])* $field:ident: $ty:ty,)* })*) => {$(
        $(#[$doc])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
        pub struct $name { $($(#[$field_doc])* pub $field: $ty,)* }

        impl $crate::layout::GpuStruct for $name {
            const NAME: &'static str = stringify!($name);
            const FIELDS: &'static [$crate::layout::Field] = &[$($crate::layout::Field {
                name: stringify!($field),
                wgsl_type: <$ty as $crate::layout::WgslType>::NAME,
                offset: std::mem::offset_of!($name, $field),
            },)*];
        }
    )*};
}

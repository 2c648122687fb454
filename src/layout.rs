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

impl Field {
    /// WGSL for the words of `value`, which has this field's type.
    fn words_of(&self, value: &str) -> String {
        match self.wgsl_type {
            "u32" => value.to_string(),
            "vec3<f32>" => format!("bitcast<vec3<u32>>({value})"),
            _ => format!("bitcast<u32>({value})"),
        }
    }

    /// WGSL for this field out of its row. Words travel as integers, which no hardware rounds or flushes.
    fn unpacked(&self) -> String {
        let (row, lane) = (self.offset / 16, ["x", "y", "z", "w"][self.offset % 16 / 4]);
        match self.wgsl_type {
            "u32" => format!("row{row}.{lane}"),
            "vec3<f32>" => format!("bitcast<vec3<f32>>(row{row}.xyz)"),
            _ => format!("bitcast<f32>(row{row}.{lane})"),
        }
    }
}

/// A struct that lies in GPU buffers.
pub trait GpuStruct: bytemuck::Pod {
    const NAME: &'static str;
    const FIELDS: &'static [Field];
    /// Rows of four words that it takes, if it consists of whole ones.
    const ROWS: usize = size_of::<Self>() / 16;

    /// The declaration for the kernels.
    fn wgsl() -> String {
        let fields: String =
            Self::FIELDS.iter().map(|f| format!("    {}: {},\n", f.name, f.wgsl_type)).collect();
        format!("struct {} {{\n{fields}}}\n", Self::NAME)
    }

    /// Functions between the struct and rows of four words, for structs that consist of whole rows. Large scenes are such
    /// rows (scene/rows.rs). Queues hold each row in a plane of its own, so that a workgroup's accesses are contiguous: as
    /// an array of structs, every 4-byte store touches a sector of its own, which made the fused schedule 2.2 times slower
    /// on an H100.
    fn wgsl_rows() -> String {
        let name = Self::NAME;
        let rows: Vec<Vec<&Field>> = (0..Self::ROWS)
            .map(|row| Self::FIELDS.iter().filter(|f| f.offset / 16 == row).collect())
            .collect();
        let mut text = String::new();
        for (i, row) in rows.iter().enumerate() {
            let words: Vec<String> = row.iter().map(|f| f.words_of(&format!("item.{}", f.name))).collect();
            let words = words.join(", ");
            text += &format!(
                "fn {name}_row{i}(item: {name}) -> vec4<u32> {{\n    return vec4<u32>({words});\n}}\n"
            );
        }
        let parameters: Vec<String> = (0..rows.len()).map(|i| format!("row{i}: vec4<u32>")).collect();
        let fields: Vec<String> = Self::FIELDS.iter().map(Field::unpacked).collect();
        let (parameters, fields) = (parameters.join(", "), fields.join(", "));
        text + &format!("fn {name}_from_rows({parameters}) -> {name} {{\n    return {name}({fields});\n}}\n")
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

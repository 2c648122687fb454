//! Eight numbers at a time: what the blocks of [`super::lanes`] are written over. No operation is fused or approximate, so
//! every implementation gives the same bits.

use glam::{BVec4A, Vec4};

/// How many numbers go together.
pub const LANES: usize = 8;

/// Eight numbers in memory.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub struct Lane(pub [f32; LANES]);

/// Arithmetic on eight numbers.
pub trait Lanes: Copy {
    type Mask: LaneMask;
    fn splat(v: f32) -> Self;
    fn load(lane: &Lane) -> Self;
    fn store(self) -> Lane;
    fn add(self, o: Self) -> Self;
    fn sub(self, o: Self) -> Self;
    fn mul(self, o: Self) -> Self;
    fn div(self, o: Self) -> Self;
    fn neg(self) -> Self;
    fn sqrt(self) -> Self;
    fn lt(self, o: Self) -> Self::Mask;
    fn le(self, o: Self) -> Self::Mask;
    fn ne(self, o: Self) -> Self::Mask;
    /// `yes` where the mask is set, else `no`.
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self;
    /// The smallest of the eight, none of which may be NaN.
    fn least(self) -> f32;
    /// first, first + 1, …
    #[inline(always)]
    fn count_from(first: f32) -> Self {
        Self::splat(first).add(Self::load(&Lane([0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0])))
    }
}

/// A truth value in every lane.
pub trait LaneMask: Copy {
    fn and(self, o: Self) -> Self;
    /// Lane i as bit i.
    fn bits(self) -> u32;
}

/// Twice four numbers, in glam's vectors: SSE2, NEON, or whatever it has for the processor.
#[derive(Clone, Copy)]
pub struct Fours([Vec4; 2]);

impl Fours {
    #[inline(always)]
    fn map(self, o: Fours, f: impl Fn(Vec4, Vec4) -> Vec4) -> Fours {
        Fours([f(self.0[0], o.0[0]), f(self.0[1], o.0[1])])
    }
    #[inline(always)]
    fn compare(self, o: Fours, f: impl Fn(Vec4, Vec4) -> BVec4A) -> [BVec4A; 2] {
        [f(self.0[0], o.0[0]), f(self.0[1], o.0[1])]
    }
}

impl Lanes for Fours {
    type Mask = [BVec4A; 2];
    #[inline(always)]
    fn splat(v: f32) -> Self {
        Fours([Vec4::splat(v); 2])
    }
    #[inline(always)]
    fn load(Lane([a, b, c, d, e, f, g, h]): &Lane) -> Self {
        Fours([Vec4::new(*a, *b, *c, *d), Vec4::new(*e, *f, *g, *h)])
    }
    #[inline(always)]
    fn store(self) -> Lane {
        let mut lane = [0.0; LANES];
        self.0[0].write_to_slice(&mut lane[..4]);
        self.0[1].write_to_slice(&mut lane[4..]);
        Lane(lane)
    }
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        self.map(o, |a, b| a + b)
    }
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        self.map(o, |a, b| a - b)
    }
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        self.map(o, |a, b| a * b)
    }
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        self.map(o, |a, b| a / b)
    }
    #[inline(always)]
    fn neg(self) -> Self {
        Fours(self.0.map(|a| -a))
    }
    #[inline(always)]
    fn sqrt(self) -> Self {
        Fours(self.0.map(Vec4::sqrt))
    }
    #[inline(always)]
    fn lt(self, o: Self) -> Self::Mask {
        self.compare(o, Vec4::cmplt)
    }
    #[inline(always)]
    fn le(self, o: Self) -> Self::Mask {
        self.compare(o, Vec4::cmple)
    }
    #[inline(always)]
    fn ne(self, o: Self) -> Self::Mask {
        self.compare(o, Vec4::cmpne)
    }
    #[inline(always)]
    fn select(mask: Self::Mask, yes: Self, no: Self) -> Self {
        Fours([Vec4::select(mask[0], yes.0[0], no.0[0]), Vec4::select(mask[1], yes.0[1], no.0[1])])
    }
    #[inline(always)]
    fn least(self) -> f32 {
        self.0[0].min(self.0[1]).min_element()
    }
}

impl LaneMask for [BVec4A; 2] {
    #[inline(always)]
    fn and(self, o: Self) -> Self {
        [self[0] & o[0], self[1] & o[1]]
    }
    #[inline(always)]
    fn bits(self) -> u32 {
        self[0].bitmask() | self[1].bitmask() << 4
    }
}

#[cfg(target_arch = "x86_64")]
pub use avx2::{Avx2, has_avx2};

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Lane, LaneMask, Lanes};
    use std::arch::x86_64::*;

    /// Whether the processor has AVX2.
    #[inline(always)]
    pub fn has_avx2() -> bool {
        std::arch::is_x86_feature_detected!("avx2")
    }

    /// Eight numbers in a register. To be used only in functions with `target_feature(enable = "avx2")`, which run only
    /// where [`has_avx2`] holds: that is what makes every call below sound.
    #[derive(Clone, Copy)]
    pub struct Avx2(__m256);

    impl Lanes for Avx2 {
        type Mask = Avx2;
        #[inline(always)]
        fn splat(v: f32) -> Self {
            Avx2(unsafe { _mm256_set1_ps(v) })
        }
        #[inline(always)]
        fn load(lane: &Lane) -> Self {
            // A lane is 32 bytes, aligned to 32.
            Avx2(unsafe { _mm256_load_ps(lane.0.as_ptr()) })
        }
        #[inline(always)]
        fn store(self) -> Lane {
            let mut lane = Lane([0.0; 8]);
            unsafe { _mm256_store_ps(lane.0.as_mut_ptr(), self.0) };
            lane
        }
        #[inline(always)]
        fn add(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_add_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn sub(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_sub_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn mul(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_mul_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn div(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_div_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn neg(self) -> Self {
            Avx2(unsafe { _mm256_xor_ps(self.0, _mm256_set1_ps(-0.0)) })
        }
        #[inline(always)]
        fn sqrt(self) -> Self {
            Avx2(unsafe { _mm256_sqrt_ps(self.0) })
        }
        #[inline(always)]
        fn lt(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_cmp_ps::<_CMP_LT_OQ>(self.0, o.0) })
        }
        #[inline(always)]
        fn le(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_cmp_ps::<_CMP_LE_OQ>(self.0, o.0) })
        }
        #[inline(always)]
        fn ne(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_cmp_ps::<_CMP_NEQ_UQ>(self.0, o.0) })
        }
        #[inline(always)]
        fn select(mask: Self, yes: Self, no: Self) -> Self {
            Avx2(unsafe { _mm256_blendv_ps(no.0, yes.0, mask.0) })
        }
        #[inline(always)]
        fn least(self) -> f32 {
            unsafe {
                let four = _mm_min_ps(_mm256_castps256_ps128(self.0), _mm256_extractf128_ps::<1>(self.0));
                let two = _mm_min_ps(four, _mm_movehl_ps(four, four));
                _mm_cvtss_f32(_mm_min_ss(two, _mm_movehdup_ps(two)))
            }
        }
    }

    impl LaneMask for Avx2 {
        #[inline(always)]
        fn and(self, o: Self) -> Self {
            Avx2(unsafe { _mm256_and_ps(self.0, o.0) })
        }
        #[inline(always)]
        fn bits(self) -> u32 {
            unsafe { _mm256_movemask_ps(self.0) as u32 }
        }
    }
}

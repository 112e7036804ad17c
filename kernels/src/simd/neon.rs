//! Four registers of 128 bits, part of every aarch64 processor.

use core::arch::aarch64::*;

use super::{Line, Operation, Simd};

#[derive(Clone, Copy)]
pub(crate) struct Neon;

/// Runs `operation` with NEON.
#[inline(never)]
pub(crate) fn run<O: Operation>(operation: O) -> O::Output {
    operation.run(Neon)
}

type Four = [float32x4_t; 4];

#[inline(always)]
fn each(one: impl Fn(usize) -> float32x4_t) -> Four {
    [one(0), one(1), one(2), one(3)]
}

// SAFETY of every block below: NEON is in the target's baseline; callers guarantee that pointers are valid.
impl Simd for Neon {
    type Vector = Four;

    const TILE_SUMS: usize = 6;

    #[inline(always)]
    fn splat(self, x: f32) -> Four {
        unsafe { [vdupq_n_f32(x); 4] }
    }

    #[inline(always)]
    fn load(self, from: &Line) -> Four {
        unsafe { self.load_pointer(from.0.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, x: Four, to: &mut Line) {
        unsafe { self.store_pointer(x, to.0.as_mut_ptr()) }
    }

    #[inline(always)]
    unsafe fn load_pointer(self, from: *const f32) -> Four {
        each(|i| unsafe { vld1q_f32(from.add(4 * i)) })
    }

    #[inline(always)]
    unsafe fn store_pointer(self, x: Four, to: *mut f32) {
        for (i, x) in x.into_iter().enumerate() {
            unsafe { vst1q_f32(to.add(4 * i), x) }
        }
    }

    #[inline(always)]
    fn add(self, x: Four, y: Four) -> Four {
        each(|i| unsafe { vaddq_f32(x[i], y[i]) })
    }

    #[inline(always)]
    fn sub(self, x: Four, y: Four) -> Four {
        each(|i| unsafe { vsubq_f32(x[i], y[i]) })
    }

    #[inline(always)]
    fn mul(self, x: Four, y: Four) -> Four {
        each(|i| unsafe { vmulq_f32(x[i], y[i]) })
    }

    #[inline(always)]
    fn div(self, x: Four, y: Four) -> Four {
        each(|i| unsafe { vdivq_f32(x[i], y[i]) })
    }

    #[inline(always)]
    fn fma(self, x: Four, y: Four, z: Four) -> Four {
        each(|i| unsafe { vfmaq_f32(z[i], x[i], y[i]) })
    }

    #[inline(always)]
    fn at_most(self, limit: Four, x: Four) -> Four {
        each(|i| unsafe { vbslq_f32(vcltq_f32(limit[i], x[i]), limit[i], x[i]) })
    }

    #[inline(always)]
    fn at_least(self, limit: Four, x: Four) -> Four {
        each(|i| unsafe { vbslq_f32(vcgtq_f32(limit[i], x[i]), limit[i], x[i]) })
    }

    #[inline(always)]
    fn where_positive(self, x: Four, y: Four) -> Four {
        let zero = self.splat(0.0);
        each(|i| unsafe { vbslq_f32(vcgtq_f32(x[i], zero[i]), y[i], zero[i]) })
    }

    #[inline(always)]
    fn sum(self, x: Four) -> f32 {
        unsafe {
            let x = vaddq_f32(vaddq_f32(x[0], x[2]), vaddq_f32(x[1], x[3]));
            let x = vadd_f32(vget_low_f32(x), vget_high_f32(x));
            vget_lane_f32::<0>(x) + vget_lane_f32::<1>(x)
        }
    }

    #[inline(always)]
    fn outlined<O: Operation>(self, operation: O) -> O::Output {
        run(operation)
    }
}

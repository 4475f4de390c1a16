//! Inner loops, compiled for the processor that there is.

use pulp::{Arch, Simd, WithSimd};

struct Work<F>(F);

impl<R, F: FnOnce() -> R> WithSimd for Work<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> R {
        (self.0)()
    }
}

/// Does work that is compiled once for every processor, and once for those with wider vectors and a count of bits; the
/// result is the same to the last bit. The closure needs `#[inline(always)]`, and what it calls too: what is not inlined, as
/// `collect` is not, is compiled for every processor. Only a closure that is given to a parameter which asks for [`FnOnce`]
/// is inlined as it says, so that [`Arch::dispatch`] alone will not do.
#[inline]
pub(crate) fn vectorised<R>(work: impl FnOnce() -> R) -> R {
    Arch::new().dispatch(Work(work))
}

/// What is found of each, as [`vectorised`] work.
pub(crate) fn each<T, R>(all: impl Iterator<Item = T>, find: impl Fn(T) -> R) -> Vec<R> {
    let mut found = Vec::with_capacity(all.size_hint().0);
    vectorised(
        #[inline(always)]
        || {
            for one in all {
                found.push(find(one));
            }
        },
    );
    found
}

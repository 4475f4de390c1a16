//! Sets of pictures that others refer to (7.3.7, 7.4.8 and 8.3.2).

use crate::bits::Bits;

/// Most pictures of a set.
const MOST: u32 = 16;

/// Pictures near another one: how far behind it they are shown, negative before it, and whether it refers to them
/// itself. Those before it come first, and the nearest of either side.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct References(pub(super) Vec<(i64, bool)>);

/// A picture that another one, or one after it, refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Reference {
    pub(super) order: OrderCount,
    /// Whether the picture itself needs it.
    pub(super) used: bool,
}

/// How the order count of a picture, the place in which it is shown, is said.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum OrderCount {
    /// By how far it is behind the picture.
    Behind(i64),
    /// By its lowest bits.
    Lowest(i64),
}

/// A picture that refers to others.
pub(super) struct Picture {
    pub(super) order: i64,
    /// Lowest bits are less than this.
    pub(super) round: i64,
}

impl Picture {
    /// Whether a picture of an order count is the one that is referred to.
    pub(super) fn is(&self, reference: &Reference, order: i64) -> bool {
        match reference.order {
            OrderCount::Behind(behind) => self.order + behind == order,
            OrderCount::Lowest(lowest) => order.rem_euclid(self.round) == lowest,
        }
    }
}

impl Reference {
    pub(super) fn near((behind, used): (i64, bool)) -> Self {
        Self {
            order: OrderCount::Behind(behind),
            used,
        }
    }
}

impl References {
    /// The set of an index behind those before it; a slice's own has the index behind the last.
    pub(super) fn read(bits: &mut Bits<'_>, before: &[Self], last: usize) -> Option<Self> {
        let index = before.len();
        if index > 0 && bits.flag()? {
            let back = match index == last {
                true => usize::try_from(bits.unsigned()?).ok()?.checked_add(1)?,
                false => 1,
            };
            return before.get(index.checked_sub(back)?)?.moved(bits);
        }
        let counts = [bits.up_to(MOST)?, bits.up_to(MOST)?];
        let mut set = Vec::new();
        for (count, sign) in counts.into_iter().zip([-1, 1]) {
            let mut behind = 0;
            for _ in 0..count {
                behind += sign * (i64::from(bits.unsigned()?) + 1);
                set.push((behind, bits.flag()?));
            }
        }
        Some(Self(set))
    }

    /// A set that is said by another one: moved, with some left out (7-61, 7-62).
    fn moved(&self, bits: &mut Bits<'_>) -> Option<Self> {
        let is_back = bits.flag()?;
        let by = i64::from(bits.unsigned()?) + 1;
        let by = if is_back { -by } else { by };
        let mut set = Vec::new();
        let own = self.0.iter().map(|(behind, _)| *behind).chain([0]);
        for behind in own {
            let used = bits.flag()?;
            let is_kept = used || bits.flag()?;
            if is_kept && behind + by != 0 {
                set.push((behind + by, used));
            }
        }
        set.sort_by_key(|(behind, _)| (*behind > 0, behind.abs()));
        (set.len() <= 2 * MOST as usize).then_some(Self(set))
    }
}

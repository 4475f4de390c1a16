//! When messages were sent, by the stamps that they have.

use arrow::array::{Array, ArrayRef, AsArray, StructArray};

use crate::Stamp;
use crate::roles::transforms::TRANSFORMS;
use crate::roles::{Fields, Message};

/// How seconds of a stamp are spelled, and the nanoseconds beside them.
const SECONDS: [&str; 3] = ["sec", "secs", "seconds"];
const NANOSECONDS: [&str; 4] = ["nanosec", "nsec", "nsecs", "nanos"];

/// What a stamp of zero means: senders leave it that do not know the time, and clocks of simulations begin there.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ZeroStamp {
    /// There is no other on the topic: its sender has no clock, and log times stand in their place.
    NoClock,
    /// It is the first instant of a clock.
    Begin,
    /// Others of the topic are of a clock that does not begin there.
    Amiss,
}

impl ZeroStamp {
    /// A stamp is of a clock that has just begun if it is this close to zero, at most (ns): messages of a topic are not
    /// farther apart, but for those that come once.
    const JUST_BEGUN: i64 = 60_000_000_000;

    /// What it means among the messages of a topic, or as many as are known together. Stamps that cannot be read say
    /// nothing.
    fn among(messages: &StructArray) -> Self {
        let mut nearest: Option<i64> = None;
        let mut hear = |fields: Fields<'_>| {
            if let Ok(Some(Stamp(stamp))) = fields.stamp()
                && stamp != 0
            {
                nearest = Some(nearest.map_or(stamp, |known| known.min(stamp)));
            }
        };
        for fields in Fields::all(messages) {
            hear(fields);
            let inside = fields.list(TRANSFORMS);
            inside.iter().flat_map(Fields::all).for_each(&mut hear);
        }
        match nearest {
            None => Self::NoClock,
            Some(stamp) if (0..=Self::JUST_BEGUN).contains(&stamp) => Self::Begin,
            Some(_) => Self::Amiss,
        }
    }
}

impl Message<'_> {
    /// The header's stamp; the log time where there is none, or where it is zero as all of its topic.
    ///
    /// # Errors
    /// In words, when there is one that cannot be read, or it is zero among others of a clock that does not begin there.
    pub fn stamp(&self) -> Result<Stamp, String> {
        let said = self.fields.stamp()?;
        if said == Some(Stamp(0)) && self.zero_stamp() == ZeroStamp::Amiss {
            return Err(
                "expected a stamp, as others of the topic have one, found zero: its sender did not know the time"
                    .to_owned(),
            );
        }
        Ok(self.time_of(said))
    }

    /// When it was that a stamp of this message says; the log time where there is none, or where it is zero and no clock
    /// begins there.
    pub(super) fn time_of(&self, said: Option<Stamp>) -> Stamp {
        let is_time = |stamp: &Stamp| *stamp != Stamp(0) || self.zero_stamp() == ZeroStamp::Begin;
        said.filter(is_time).unwrap_or(self.log_time)
    }

    /// What a stamp of zero means on its topic: all messages beside it are asked, once.
    fn zero_stamp(&self) -> ZeroStamp {
        *self
            .zero
            .get_or_init(|| ZeroStamp::among(self.fields.members))
    }
}

impl Fields<'_> {
    /// The stamp of the header, or the message's own; `None` where it has neither.
    ///
    /// # Errors
    /// As [`Fields::stamp_at`].
    pub fn stamp(&self) -> Result<Option<Stamp>, String> {
        match self.stamp_at(&["header", "stamp"])? {
            None => self.stamp_at(&["timestamp"]),
            found => Ok(found),
        }
    }

    /// The stamp at a path: seconds and nanoseconds, as ROS 1, ROS 2, protobuf and JSON spell them. `None` where it is
    /// missing; senders that do not know the time leave it zero.
    ///
    /// # Errors
    /// In words, when something is there that is no stamp of 64 bits.
    pub fn stamp_at(&self, path: &[&str]) -> Result<Option<Stamp>, String> {
        let Some(said) = self.at(path).filter(|said| has_any(said, self.row)) else {
            return Ok(None);
        };
        let part = |names: &[&str]| {
            let of = |name: &&str| self.number(&[path, &[*name]].concat());
            let found = names.iter().find_map(of);
            found.filter(|number| number.is_finite())
        };
        let stamp = || {
            let seconds = part(&SECONDS)? as i64;
            let fraction = part(&NANOSECONDS)? as i64;
            let whole = seconds.checked_mul(1_000_000_000)?;
            whole.checked_add(fraction).map(Stamp)
        };
        match stamp() {
            Some(stamp) => Ok(Some(stamp)),
            None => Err(format!(
                "expected seconds ({}) and nanoseconds ({}) at {}, found {}",
                SECONDS.join(", "),
                NANOSECONDS.join(", "),
                path.join("."),
                members_of(&said)
            )),
        }
    }

    /// The stamp at a path, which names something that was recorded then.
    ///
    /// # Errors
    /// In words, where there is none, or zero.
    pub(super) fn stamp_of(&self, path: &[&str]) -> Result<Stamp, String> {
        let found = self.stamp_at(path)?.filter(|stamp| *stamp != Stamp(0));
        found.ok_or_else(|| format!("expected a stamp in {}", path.join(".")))
    }
}

/// Whether a value says anything: messages without a member may be read as one of nothing but nulls.
fn has_any(value: &ArrayRef, row: usize) -> bool {
    match value.as_struct_opt() {
        Some(members) => members.columns().iter().any(|member| member.is_valid(row)),
        None => true,
    }
}

/// What a value has, for a sentence that says what is found.
fn members_of(value: &ArrayRef) -> String {
    match value.as_struct_opt() {
        Some(members) => members.column_names().join(", "),
        None => format!("a value of type {}", value.data_type()),
    }
}

#[cfg(test)]
mod tests {
    use std::cell::OnceCell;
    use std::sync::Arc;

    use arrow::array::{Int64Array, StringArray, UInt32Array};

    use super::*;
    use crate::roles::tests::members;
    use crate::roles::{CameraNames, OdometryOf};

    /// Messages whose header has a stamp of these members, one each.
    fn headers(seconds: (&str, Vec<i64>), fraction: (&str, Vec<u32>)) -> StructArray {
        let stamp = members(vec![
            (seconds.0, Arc::new(Int64Array::from(seconds.1)) as ArrayRef),
            (
                fraction.0,
                Arc::new(UInt32Array::from(fraction.1)) as ArrayRef,
            ),
        ]);
        let header = members(vec![("stamp", Arc::new(stamp) as ArrayRef)]);
        members(vec![("header", Arc::new(header) as ArrayRef)])
    }

    #[test]
    fn stamps_are_read_however_seconds_and_nanoseconds_are_spelled() {
        for seconds in SECONDS {
            for nanoseconds in NANOSECONDS {
                let messages = headers((seconds, vec![1_700_000_000]), (nanoseconds, vec![7]));
                let read = Fields::new(&messages, 0).stamp();
                let expected = Stamp(1_700_000_000_000_000_007);
                assert_eq!(read, Ok(Some(expected)), "{seconds} {nanoseconds}");
            }
        }
    }

    #[test]
    fn a_stamp_that_is_there_and_cannot_be_read_is_none_that_is_missing() {
        let said = |messages: &StructArray| Fields::new(messages, 0).stamp();
        let expected = "expected seconds (sec, secs, seconds) and nanoseconds (nanosec, nsec, nsecs, nanos) at ";
        for (messages, found) in [
            (
                headers(("secs", vec![1]), ("ns", vec![2])),
                "header.stamp, found secs, ns",
            ),
            (
                headers(("sec", vec![i64::MAX]), ("nsec", vec![2])),
                "header.stamp, found sec, nsec",
            ),
            (
                members(vec![(
                    "timestamp",
                    Arc::new(StringArray::from(vec!["2026-11-27"])) as ArrayRef,
                )]),
                "timestamp, found a value of type Utf8",
            ),
        ] {
            assert_eq!(said(&messages), Err(format!("{expected}{found}")));
        }
        let nulls = members(vec![
            (
                "sec",
                Arc::new(Int64Array::from(vec![None::<i64>])) as ArrayRef,
            ),
            (
                "nsec",
                Arc::new(UInt32Array::from(vec![None::<u32>])) as ArrayRef,
            ),
        ]);
        let empty = members(vec![("timestamp", Arc::new(nulls) as ArrayRef)]);
        assert_eq!(said(&empty), Ok(None));
        let other = members(vec![(
            "volts",
            Arc::new(Int64Array::from(vec![12])) as ArrayRef,
        )]);
        assert_eq!(said(&other), Ok(None));
    }

    #[test]
    fn zero_is_a_stamp_where_a_clock_begins_and_the_log_time_where_there_is_none() {
        let log_time = Stamp(1_700_000_000_000_000_000);
        let first = |stamps: Vec<i64>| stamps_of(stamps, log_time).0.swap_remove(0);
        assert_eq!(first(vec![0, 0, 0]), Ok(log_time));
        assert_eq!(first(vec![0, 1, 2]), Ok(Stamp(0)));
        assert_eq!(first(vec![5, 0]), Ok(Stamp(5_000_000_000)));
        for amiss in [vec![0, 1_700_000_000], vec![0, 0, 61], vec![0, -5]] {
            let said = first(amiss).err().unwrap_or_default();
            assert!(said.contains("found zero"), "{said}");
        }
    }

    #[test]
    fn what_zero_means_is_asked_when_there_is_one() {
        let at = |seconds: [i64; 3]| seconds.map(|second| Ok(Stamp(second * 1_000_000_000)));
        let (read, meaning) = stamps_of(vec![1, 2, 3], Stamp(7));
        assert_eq!((read, meaning), (at([1, 2, 3]).to_vec(), None));
        let (read, meaning) = stamps_of(vec![1, 0, 3], Stamp(7));
        let begin = Some(ZeroStamp::Begin);
        assert_eq!((read, meaning), (at([1, 0, 3]).to_vec(), begin));
    }

    /// The stamps of messages of a topic whose headers say these seconds, as they are read, and what zero means where that
    /// was asked.
    fn stamps_of(
        seconds: Vec<i64>,
        log_time: Stamp,
    ) -> (Vec<Result<Stamp, String>>, Option<ZeroStamp>) {
        let (cameras, robot) = (CameraNames::default(), OdometryOf::default());
        let fractions = vec![0; seconds.len()];
        let messages = headers(("sec", seconds), ("nanosec", fractions));
        let zero = OnceCell::new();
        let stamp = |fields| {
            let message = Message {
                site: "lot",
                session: "a",
                topic: "/odom",
                log_time,
                fields,
                zero: &zero,
                image: None,
                cameras: &cameras,
                bits: None,
                robot: &robot,
                still: None,
            };
            message.stamp()
        };
        let read = Fields::all(&messages).map(stamp).collect();
        (read, zero.get().copied())
    }
}

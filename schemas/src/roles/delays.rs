//! How long after their stamps messages were logged: clocks that differ show by it.

use crate::roles::transforms::TRANSFORMS;
use crate::roles::{Fields, FromMessage, Message, Messages};
use crate::{Stamp, record};

record! {
    /// When a message was sent, by its own stamp, and when it was logged.
    #[layer("delays", key(stamp))]
    pub struct Delay {
        /// Its stamp.
        stamp: Stamp ["ns"],
        /// Its log time.
        log_time: Stamp ["ns"],
    }
}

/// How messages of any type become [`Delay`]s.
pub const DELAYS: Messages = Messages::of::<Delay>(&[]);

impl FromMessage for Delay {
    const MEMBERS: &'static [&'static str] = &["header", "timestamp", TRANSFORMS];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        // A stamp that cannot be read is the business of the roles that read it; one of zero is none.
        let own = message.fields.stamp().unwrap_or_default();
        let inside = || {
            let transforms = message.fields.list(TRANSFORMS)?;
            let first = Fields::all(&transforms).next()?;
            first.stamp().unwrap_or_default()
        };
        let stamp = own.or_else(inside).filter(|stamp| *stamp != Stamp(0));
        let delay = stamp.map(|stamp| Self {
            stamp,
            log_time: message.log_time,
        });
        Ok(delay.into_iter().collect())
    }
}

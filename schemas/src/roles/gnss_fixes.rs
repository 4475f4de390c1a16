//! GNSS fixes: where on earth an antenna is.

use crate::roles::role::fullest;
use crate::roles::{FromMessage, Message, Messages, Role};
use crate::{Stamp, record};

record! {
    /// One position of a GNSS receiver. Messages that say that there is no fix give no row: by their status, or, where they
    /// have none, by a position that is not a number.
    #[layer("gnss_fixes", key(site, session, stamp))]
    pub struct GnssFix {
        /// Site that the session belongs to.
        site: String,
        /// Session that the fix belongs to.
        session: String,
        /// Instant of the fix.
        stamp: Stamp ["ns"],
        /// Topic that the fix was recorded on.
        topic: String,
        /// The antenna's frame; empty where the log does not say it.
        frame: String,
        /// Latitude in WGS 84, north is positive.
        latitude_deg: f64 ["deg", "WGS 84"],
        /// Longitude in WGS 84, east is positive.
        longitude_deg: f64 ["deg", "WGS 84"],
        /// Height above the ellipsoid; null where the receiver does not know it.
        height_m: Option<f64> ["m", "WGS 84"],
        /// Standard deviation along east and along north, their root mean square; null where the receiver does not know it.
        horizontal_sd_m: Option<f64> ["m"],
        /// Standard deviation of the height; null where the receiver does not know it.
        vertical_sd_m: Option<f64> ["m"],
    }
}

/// The one topic with fixes of a GNSS receiver: two receivers have two antennas, and one is enough.
pub const ROLE: Role = Role::of::<GnssFix>(Messages {
    choose: fullest,
    single: true,
    shared: true,
    ..Messages::of::<GnssFix>(&["sensor_msgs/NavSatFix", "foxglove.LocationFix"])
});

/// `COVARIANCE_TYPE_UNKNOWN` of both messages.
const UNKNOWN: f64 = 0.0;

impl FromMessage for GnssFix {
    const MEMBERS: &'static [&'static str] = &[
        "header",
        "timestamp",
        "frame_id",
        "status",
        "latitude",
        "longitude",
        "altitude",
        "position_covariance",
        "position_covariance_type",
    ];

    fn from_message(message: &Message<'_>) -> Result<Vec<Self>, String> {
        let fields = &message.fields;
        // NavSatStatus: STATUS_NO_FIX is -1, and receivers that have not begun say -2.
        let status = fields.number(&["status", "status"]);
        if status.is_some_and(|status| status < 0.0) {
            return Ok(Vec::new());
        }
        let angle = |name: &str, most: f64| {
            let found = fields.number(&[name]).ok_or(format!("expected {name}"))?;
            // So messages without a status say that there is no fix.
            if found.is_nan() && status.is_none() {
                return Ok(None);
            }
            match found.abs() <= most {
                true => Ok(Some(found)),
                false => Err(format!("expected {name} within {most}°, found {found}")),
            }
        };
        let latitude = angle("latitude", 90.0)?;
        // Some count it to 360.
        let longitude = angle("longitude", 360.0)?;
        let (Some(latitude_deg), Some(longitude)) = (latitude, longitude) else {
            return Ok(Vec::new());
        };
        let known = fields.number(&["position_covariance_type"]) != Some(UNKNOWN);
        let covariance = fields.numbers(&["position_covariance"]);
        let sd = |entries: &[usize]| {
            let sum = entries.iter().map(|entry| covariance.get(*entry).copied());
            let sum: f64 = sum.sum::<Option<f64>>()?;
            let sd = (sum / entries.len() as f64).sqrt();
            (known && sd.is_finite() && sd > 0.0).then_some(sd)
        };
        Ok(vec![Self {
            site: message.site.to_owned(),
            session: message.session.to_owned(),
            stamp: message.stamp()?,
            topic: message.topic.to_owned(),
            frame: message.frame(),
            latitude_deg,
            longitude_deg: (longitude + 180.0).rem_euclid(360.0) - 180.0,
            height_m: fields
                .number(&["altitude"])
                .filter(|height| height.is_finite()),
            horizontal_sd_m: sd(&[0, 4]),
            vertical_sd_m: sd(&[8]),
        }])
    }
}

#[cfg(test)]
mod tests {
    use std::cell::OnceCell;
    use std::sync::Arc;

    use arrow::array::{ArrayRef, Float64Array, Int8Array};

    use super::*;
    use crate::roles::tests::members;
    use crate::roles::{CameraNames, Fields, OdometryOf};

    /// How many rows a message with this status and latitude gives.
    fn rows(status: Option<i8>, latitude_deg: f64) -> Result<usize, String> {
        let number = |number: f64| Arc::new(Float64Array::from(vec![number])) as ArrayRef;
        let status = status.map(|status| {
            let number = Arc::new(Int8Array::from(vec![status])) as ArrayRef;
            let status = Arc::new(members(vec![("status", number)])) as ArrayRef;
            ("status", status)
        });
        let place = [
            ("latitude", number(latitude_deg)),
            ("longitude", number(10.5)),
        ];
        let members = members(place.into_iter().chain(status).collect());
        let message = Message {
            site: "lot",
            session: "a",
            topic: "/fix",
            log_time: Stamp(1),
            fields: Fields::new(&members, 0),
            zero: &OnceCell::new(),
            image: None,
            cameras: &CameraNames::default(),
            bits: None,
            robot: &OdometryOf::default(),
            still: None,
        };
        GnssFix::from_message(&message).map(|rows| rows.len())
    }

    #[test]
    fn a_fix_that_is_not_a_number_is_senseless_and_no_fix_is_none() {
        for status in [Some(0), Some(2), None] {
            assert_eq!(rows(status, 52.25), Ok(1));
        }
        for nothing in [52.25, f64::NAN] {
            assert_eq!(rows(Some(-1), nothing), Ok(0));
        }
        // foxglove.LocationFix has no status.
        assert_eq!(rows(None, f64::NAN), Ok(0));
        for senseless in [f64::NAN, f64::INFINITY, 91.0] {
            let said = format!("expected latitude within 90°, found {senseless}");
            assert_eq!(rows(Some(0), senseless), Err(said));
        }
    }
}

//! Where frames are fixed, which a session must not say in two ways.

use crate::Pose;

/// What is the same but for how it was computed: metres, and parts of a unit quaternion.
const SAME: f64 = 1e-6;

/// That a frame is fixed to another one, for all time.
#[derive(Debug, Clone, PartialEq)]
pub struct Mount {
    /// The frame.
    pub frame: String,
    /// The frame that it is fixed to.
    pub to: String,
    /// Where it is in that.
    pub pose: Pose,
}

impl Mount {
    /// In words, how it contradicts another mount of its frame, whichever of them came first; `None` where they agree.
    pub fn contradiction(&self, other: &Self) -> Option<String> {
        let frame = &self.frame;
        if self.to != other.to {
            let [one, two] = match self.to < other.to {
                true => [&self.to, &other.to],
                false => [&other.to, &self.to],
            };
            return Some(format!(
                "frame `{frame}` is fixed to `{one}` and to `{two}`"
            ));
        }
        let (metres, degrees) = apart(&self.pose, &other.pose)?;
        let to = &self.to;
        Some(format!(
            "frame `{frame}` is fixed to `{to}` in two ways, {metres} m and {degrees}° from each other"
        ))
    }
}

/// How far poses are from each other, in metres and degrees; `None` where they are the same.
pub(super) fn apart(one: &Pose, two: &Pose) -> Option<(f64, f64)> {
    let [one, two] = [one, two].map(Pose::to_array);
    let ([x, y, z, q @ ..], [ox, oy, oz, o @ ..]) = (one, two);
    // A quaternion and its opposite turn alike.
    let along: f64 = q.iter().zip(&o).map(|(a, b)| a * b).sum();
    let sign = 1.0_f64.copysign(along);
    let turned = [0, 1, 2, 3].map(|at| q[at] - sign * o[at]);
    let moved = [x - ox, y - oy, z - oz];
    if moved.iter().chain(&turned).all(|part| part.abs() <= SAME) {
        return None;
    }
    let length = |parts: &[f64]| parts.iter().map(|part| part * part).sum::<f64>().sqrt();
    let angle = 4.0 * (length(&turned) / 2.0).min(1.0).asin();
    let rounded = |value: f64| (value * 1e6).round() / 1e6;
    Some((rounded(length(&moved)), rounded(angle.to_degrees())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mount(to: &str, pose: [f64; 7]) -> Mount {
        Mount {
            frame: "left".to_owned(),
            to: to.to_owned(),
            pose: Pose::from_array(pose),
        }
    }

    #[test]
    fn two_frames_or_two_places_contradict_and_noise_does_not() {
        let held = mount("base", [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
        let noise = mount("base", [1.0 + 9e-7, 2.0, 3.0, 0.0, 5e-7, 0.0, -1.0]);
        assert_eq!(held.contradiction(&held), None);
        assert_eq!(held.contradiction(&noise), None);
        let elsewhere = mount("base", [1.0, 2.3, 3.4, 0.0, 0.0, 0.0, 1.0]);
        let said = "frame `left` is fixed to `base` in two ways, 0.5 m and 0° from each other";
        assert_eq!(held.contradiction(&elsewhere).as_deref(), Some(said));
        let half = std::f64::consts::FRAC_1_SQRT_2;
        let turned = mount("base", [1.0, 2.0, 3.0, 0.0, 0.0, -half, -half]);
        let said = "frame `left` is fixed to `base` in two ways, 0 m and 90° from each other";
        assert_eq!(turned.contradiction(&held).as_deref(), Some(said));
        let mast = mount("mast", [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0]);
        let said = "frame `left` is fixed to `base` and to `mast`";
        assert_eq!(held.contradiction(&mast).as_deref(), Some(said));
        assert_eq!(mast.contradiction(&held).as_deref(), Some(said));
    }
}

//! The nine classes of the street.

/// What a pixel shows; the number is its value in label images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Class {
    /// Trees, hedges, bushes.
    Tree,
    /// The sky.
    Sky,
    /// Carriageway and parking lanes.
    Road,
    /// Traffic signs, boards, shop signs.
    Sign,
    /// Sidewalks and paved yards.
    Sidewalk,
    /// Markings on the ground.
    GroundSign,
    /// Houses.
    Building,
    /// Cars.
    Car,
    /// Grass, poles, bins, fences.
    Other,
}

/// Names of the classes in the order of their values.
pub const STREET_CLASSES: [&str; 9] = [
    "tree",
    "sky",
    "road",
    "sign",
    "sidewalk",
    "ground sign",
    "building",
    "car",
    "other",
];

/// A colour for each class, for pictures.
pub const STREET_COLOURS: [[u8; 3]; 9] = [
    [60, 160, 60],
    [110, 170, 230],
    [120, 120, 120],
    [30, 60, 230],
    [150, 60, 170],
    [250, 150, 20],
    [130, 80, 40],
    [220, 30, 30],
    [20, 20, 20],
];

impl Class {
    /// What a labeller takes this for, and how often of all times it errs; shares add up to 1.
    pub fn confusions(self) -> &'static [(Class, f32)] {
        use Class::{Building, Car, GroundSign, Other, Road, Sidewalk, Sign, Sky, Tree};
        match self {
            Tree => &[(Other, 0.5), (Building, 0.35), (Sky, 0.15)],
            Sky => &[(Building, 0.55), (Tree, 0.45)],
            Road => &[(Sidewalk, 0.65), (Other, 0.2), (GroundSign, 0.15)],
            Sign => &[(Building, 0.5), (Other, 0.3), (Tree, 0.2)],
            Sidewalk => &[(Road, 0.6), (Other, 0.4)],
            GroundSign => &[(Road, 0.9), (Sidewalk, 0.1)],
            Building => &[(Other, 0.35), (Tree, 0.35), (Sign, 0.15), (Sky, 0.15)],
            Car => &[(Other, 0.4), (Building, 0.3), (Road, 0.3)],
            Other => &[(Tree, 0.4), (Sidewalk, 0.25), (Building, 0.25), (Road, 0.1)],
        }
    }

    /// What it is taken for when chance (0 to 1) has it so.
    pub fn mistaken(self, chance: f32) -> Class {
        let mut rest = chance;
        let confusions = self.confusions();
        for (class, share) in confusions {
            rest -= share;
            if rest < 0.0 {
                return *class;
            }
        }
        confusions[0].0
    }
}

//! Colour of each pixel: CIE L*a*b* and chromaticity, as bytes.

use std::sync::OnceLock;

use crate::learning::dense_crf::ColourView;

/// Channels of each pixel, one after the other: L*, a*, b*, red and green chromaticity.
pub(super) const CHANNELS: usize = 5;

/// sRGB of 8 bits to linear light, and the cube root of CIE's definition at `i / (CUBE_ROOTS - 1)`.
struct Tables {
    linear: [f32; 256],
    cube_root: Vec<f32>,
}

const CUBE_ROOTS: usize = 4096;

fn tables() -> &'static Tables {
    static TABLES: OnceLock<Tables> = OnceLock::new();
    TABLES.get_or_init(|| Tables {
        linear: std::array::from_fn(|value| {
            let value = value as f32 / 255.0;
            if value <= 0.040_45 {
                value / 12.92
            } else {
                ((value + 0.055) / 1.055).powf(2.4)
            }
        }),
        cube_root: (0..CUBE_ROOTS)
            .map(|step| {
                let t = step as f32 / (CUBE_ROOTS - 1) as f32;
                if t > 0.008_856 {
                    t.cbrt()
                } else {
                    7.787 * t + 16.0 / 116.0
                }
            })
            .collect(),
    })
}

fn byte(value: f32) -> u8 {
    // The conversion saturates.
    value.round() as u8
}

/// What is stored of one pixel. L* fills the byte; a* and b* are trebled about 128, as streets are mostly grey;
/// chromaticities are doubled, as hardly any colour has two thirds of its light in one channel.
pub(super) fn channels([red, green, blue]: [u8; 3]) -> [u8; CHANNELS] {
    let tables = tables();
    let [r, g, b] = [red, green, blue].map(|value| tables.linear[usize::from(value)]);
    // White D65 is divided out of the rows already.
    let xyz = [
        0.433_891 * r + 0.376_235 * g + 0.189_906 * b,
        0.212_649 * r + 0.715_169 * g + 0.072_182 * b,
        0.017_756 * r + 0.109_478 * g + 0.872_915 * b,
    ];
    let [x, y, z] = xyz.map(|value| {
        let step = (value * (CUBE_ROOTS - 1) as f32 + 0.5) as usize;
        tables.cube_root[step.min(CUBE_ROOTS - 1)]
    });
    let sum = (u32::from(red) + u32::from(green) + u32::from(blue)).max(1) as f32;
    let share = |value: u8| byte(510.0 * f32::from(value) / sum);
    [
        byte(2.55 * (116.0 * y - 16.0)),
        byte(128.0 + 3.0 * 500.0 * (x - y)),
        byte(128.0 + 3.0 * 200.0 * (y - z)),
        share(red),
        share(green),
    ]
}

/// Rec. 601 luma of each pixel, in 1/16 of a grey value.
pub(super) fn luma(image: &ColourView<'_>) -> Vec<u32> {
    image
        .pixels()
        .iter()
        .map(|&[red, green, blue]| {
            (77 * u32::from(red) + 150 * u32::from(green) + 29 * u32::from(blue) + 8) >> 4
        })
        .collect()
}

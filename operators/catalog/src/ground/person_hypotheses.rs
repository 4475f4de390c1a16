#![doc = include_str!("person_hypotheses.md")]

use evermap_algorithms::ground::people::PeopleParams;
use evermap_algorithms::ground::people::search::people;
use evermap_contract::{Fault, Operator, Port, Reach, Reason, Work};
use evermap_schemas::layers::{FrameImage, PersonHypothesis};

use crate::inputs::people::{self as looking, Looking, Room, Sight};
use crate::inputs::rig::{self, OfVehicle};

/// See the module's page.
pub struct PersonHypotheses;

impl Operator for PersonHypotheses {
    const NAME: &'static str = "person_hypotheses";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("person_hypotheses.md");
    type Params = OfVehicle<PeopleParams>;
    type Output = PersonHypothesis;

    fn work() -> Work<Self::Params> {
        let images = Port::session::<FrameImage>("images").pixels("image");
        let sides = rig::ports(Reach::Session).to_vec();
        Work::each_image(images, sides, Looking::new, hypotheses)
    }

    fn check(params: &Self::Params) -> Result<(), Fault> {
        looking::check(&params.options)
    }
}

fn hypotheses(
    looking: &Looking,
    image: FrameImage,
    bytes: &[u8],
    room: &mut Room,
) -> Result<Vec<PersonHypothesis>, Reason> {
    let named = (&*image.session, &*image.camera, image.stamp);
    let found = looking.at(named, &image.image.format, bytes, room, |sight| {
        let Sight {
            upright,
            image,
            detector,
            params,
        } = sight;
        people(upright, image, detector, params)
    })?;
    let rows = (0..).zip(found).map(|(person, found)| PersonHypothesis {
        site: image.site.clone(),
        session: image.session.clone(),
        stamp: image.stamp,
        camera: image.camera.clone(),
        person,
        x: found.position[0],
        y: found.position[1],
        z: looking.plane_m(),
        var_x_m2: found.covariance[0],
        cov_xy_m2: found.covariance[1],
        var_y_m2: found.covariance[2],
        range_m: found.range_m,
        rectangle: found.rectangle.to_vec(),
        score: found.score,
        probability: found.probability,
        description: found.description,
    });
    Ok(rows.collect())
}

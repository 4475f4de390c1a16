#![doc = include_str!("person_questions.md")]

use std::collections::BTreeMap;

use evermap_algorithms::ground::people::teaching::{
    Belief, LeastCertain, belief, questions, untaught,
};
use evermap_algorithms::learning::gaussian_process::LinearProcess;
use evermap_contract::{
    Emit, Fault, Key, NothingToChoose, Operator, Pixels, Port, Sides, Stream, Work,
};
use evermap_schemas::layers::{PersonExample, PersonHypothesis, PersonModel, PersonQuestion};

use crate::inputs::asking::reason;
use crate::inputs::painting::ImageKey;
use crate::inputs::people::{ANSWERED_M, learnt};

/// See the module's page.
pub struct PersonQuestions;

impl Operator for PersonQuestions {
    const NAME: &'static str = "person_questions";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("person_questions.md");
    type Params = NothingToChoose;
    type Output = PersonQuestion;

    fn work() -> Work<Self::Params> {
        let hypotheses = Port::site::<PersonHypothesis>("hypotheses");
        let sides = vec![
            Port::site::<PersonModel>("models").optional(),
            Port::site::<PersonExample>("examples").optional(),
        ];
        Work::stream::<Asking>(hypotheses, Key::SITE, sides)
    }
}

/// What may be asked of a site.
struct Asking {
    /// What is known of answers; `None` before there are any, and no hypothesis either.
    known: Option<LinearProcess>,
    /// Where in the vehicle frame (m) those are who were answered, by image.
    answered: BTreeMap<ImageKey, Vec<[f64; 2]>>,
    open: LeastCertain<(PersonHypothesis, Belief)>,
}

impl Stream for Asking {
    type Params = NothingToChoose;
    type Row = PersonHypothesis;

    fn open(_: &NothingToChoose, sides: &Sides) -> Result<Self, Fault> {
        let mut answered = BTreeMap::<ImageKey, Vec<[f64; 2]>>::new();
        for one in sides.rows::<PersonExample>("examples")? {
            let image = answered.entry((one.session, one.stamp, one.camera));
            image.or_default().push([one.x, one.y]);
        }
        Ok(Self {
            known: learnt(sides)?,
            answered,
            open: LeastCertain::default(),
        })
    }

    fn push(
        &mut self,
        rows: Vec<PersonHypothesis>,
        _: &Pixels,
        emit: &mut Emit<'_>,
    ) -> Result<(), Fault> {
        for row in rows {
            if self.is_answered(&row) {
                continue;
            }
            if self.known.is_none() {
                self.known = untaught(row.description.len());
            }
            let known = self.known.as_ref();
            let believed = known.and_then(|it| belief(it, &row.description, row.probability));
            match believed {
                Some(belief) => self.open.add(belief.probability, (row, belief)),
                None => emit.skip("person whose description is not like those of others", 1),
            }
        }
        Ok(())
    }

    fn close(self, emit: &mut Emit<'_>) -> Result<(), Fault> {
        let Some(known) = self.known else {
            return Ok(());
        };
        let open = self.open.least_certain();
        let shown = open
            .iter()
            .map(|(row, belief)| (row.description.as_slice(), belief.probability));
        let asked = questions(&known, &shown.collect::<Vec<_>>());
        let rows = (1..).zip(asked).map(|(number, (at, gain))| {
            let (row, belief) = &open[at];
            question(number, row, belief, gain)
        });
        emit.rows(rows.collect())
    }
}

impl Asking {
    fn is_answered(&self, row: &PersonHypothesis) -> bool {
        let image = (row.session.clone(), row.stamp, row.camera.clone());
        let of_image = self.answered.get(&image);
        of_image.is_some_and(|places| {
            let mut places = places.iter();
            places.any(|[x, y]| (row.x - x).hypot(row.y - y) <= ANSWERED_M)
        })
    }
}

fn question(number: u32, row: &PersonHypothesis, belief: &Belief, gain: f64) -> PersonQuestion {
    PersonQuestion {
        site: row.site.clone(),
        question: number,
        session: row.session.clone(),
        stamp: row.stamp,
        camera: row.camera.clone(),
        person: row.person,
        x: row.x,
        y: row.y,
        range_m: row.range_m,
        rectangle: row.rectangle.clone(),
        mean: belief.mean,
        variance: belief.variance,
        probability: belief.probability,
        gain,
        reason: reason(belief.probability).to_owned(),
    }
}

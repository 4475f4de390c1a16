//! Labels: from acts of annotation to what holds, where it is held, and where it is now. Operators do this when a plan runs;
//! programs that people draw with do the same on the version that is looked at.

mod holds;
mod placing;

use std::collections::BTreeMap;

use evermap_algorithms::labels::folding::{self, Act, FoldedLabels, folded};
use evermap_algorithms::labels::shapes::{MOST_POINTS, crossing, is_box};
use evermap_contract::Reason;
use evermap_schemas::layers::LabelAnchor;
use evermap_schemas::roles::Annotation;

use holds::Framed;
pub use holds::{Holds, MapRows};
pub use placing::{Placer, PlacingParams};

/// Counts what is left out, or does not fit together, by reason.
pub type Tell<'t> = &'t mut dyn FnMut(Reason, u64);

/// A label that there is.
struct Current<'a> {
    standing: Act,
    /// The act that says where it is.
    place: &'a Annotation,
    /// The latest act.
    last: &'a Annotation,
}

/// The labels that acts make, each with what holds it. `before` is what held them already: a label that is drawn as it was
/// stays where it is held; the others are tied to `holds`, the map that they were drawn on.
pub fn anchored(
    mut acts: Vec<Annotation>,
    before: Vec<LabelAnchor>,
    holds: &Holds,
    tell: Tell<'_>,
) -> Vec<LabelAnchor> {
    once_each(&mut acts);
    let before: BTreeMap<String, LabelAnchor> = before
        .into_iter()
        .map(|row| (row.label.clone(), row))
        .collect();
    let current = current(&acts, tell);
    let hold = |label: &Current<'_>| held(label, before.get(&label.place.id), holds, tell);
    current.iter().filter_map(hold).collect()
}

/// Leaves acts out that are there twice, in two logs: one of them may be a copy of the other.
fn once_each(acts: &mut Vec<Annotation>) {
    acts.sort_by(|a, b| order(a).cmp(&order(b)));
    acts.dedup_by(|copy, kept| {
        let session = std::mem::replace(&mut copy.session, kept.session.clone());
        let equal = copy == kept;
        copy.session = session;
        equal
    });
}

fn order(act: &Annotation) -> impl Ord + '_ {
    (
        act.stamp,
        &act.author,
        act.sequence,
        &act.id,
        &act.act,
        &act.session,
    )
}

/// The labels that there are, by name.
fn current<'a>(acts: &'a [Annotation], tell: Tell<'_>) -> Vec<Current<'a>> {
    let mut said = Vec::with_capacity(acts.len());
    let mut rows = Vec::with_capacity(acts.len());
    for row in acts {
        match read(row) {
            Ok(act) => {
                said.push(act);
                rows.push(row);
            }
            Err(reason) => tell(reason, 1),
        }
    }
    let FoldedLabels {
        labels,
        conflicts,
        strays,
        ..
    } = folded(&said);
    tell(
        "annotation that contradicts another person's; the later holds".into(),
        conflicts,
    );
    tell("annotation of a label that was never drawn".into(), strays);
    let label = |label: evermap_algorithms::labels::folding::Label| Current {
        standing: label.standing,
        place: rows[label.place],
        last: rows[label.last],
    };
    labels.into_values().map(label).collect()
}

/// An act as it is folded; an outline that makes no sense is left out with its act.
fn read(row: &Annotation) -> Result<folding::Annotation<'_>, Reason> {
    if row.points.len() > MOST_POINTS {
        return Err("label with more than 4096 points".into());
    }
    match row.shape.as_deref() {
        Some("polygon") if crossing(&row.points).is_some() => {
            return Err("label whose outline crosses itself".into());
        }
        Some("box") if !is_box(&row.points) => {
            return Err("box that is not a rectangle around its frame".into());
        }
        _ => {}
    }
    Ok(folding::Annotation {
        label: &row.id,
        stamp: row.stamp.0,
        author: &row.author,
        sequence: row.sequence,
        log: &row.session,
        act: Act::named(&row.act).ok_or("annotation of an unknown act")?,
        places: row.shape.is_some(),
    })
}

fn held(
    label: &Current<'_>,
    before: Option<&LabelAnchor>,
    holds: &Holds,
    tell: Tell<'_>,
) -> Option<LabelAnchor> {
    let Current { place, last, .. } = label;
    let (shape, drawn) = (place.shape.clone()?, place.map_from_label.clone()?);
    let same = |row: &&LabelAnchor| {
        (&row.shape, &row.points, &row.map_from_label) == (&shape, &place.points, &drawn)
    };
    let before = before.filter(same);
    let kept = before.and_then(|row| row.anchor.clone());
    let chosen = || kept.or_else(|| holds.anchor(&drawn));
    let anchor = place.anchor.clone().or_else(chosen);
    if anchor.is_none() {
        tell("label too far from every vehicle pose".into(), 1);
    }
    let framed = before.and_then(framed).or_else(|| holds.frame(&drawn));
    Some(LabelAnchor {
        site: last.site.clone(),
        label: last.id.clone(),
        kind: last.kind.clone(),
        standing: label.standing.name().to_owned(),
        author: last.author.clone(),
        said: last.stamp,
        log: place.session.clone(),
        shape,
        points: place.points.clone(),
        map_from_label: drawn,
        anchor,
        frame: framed.as_ref().map(|framed| framed.number),
        frame_session: framed.as_ref().map(|framed| framed.of.0.clone()),
        frame_stamp: framed.as_ref().map(|framed| framed.of.1),
        frame_from_label: framed.map(|framed| framed.frame_from_label),
    })
}

/// The frame that holds a label already; `None` where it has none, or an older evermap did not note which one it is.
fn framed(row: &LabelAnchor) -> Option<Framed> {
    Some(Framed {
        number: row.frame?,
        of: (row.frame_session.clone()?, row.frame_stamp?),
        frame_from_label: row.frame_from_label.clone()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use evermap_schemas::roles::annotations::ACTS;

    /// What logs may say is what is folded, by the same words.
    #[test]
    fn every_act_of_a_log_has_its_meaning() {
        for act in ACTS {
            assert_eq!(Act::named(act).map(Act::name), Some(act));
        }
    }
}

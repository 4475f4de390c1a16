#![doc = include_str!("relation_index.md")]

use evermap_algorithms::semantic_map::relation_index::{self, ViewSet, names_digest};
use evermap_algorithms::semantic_map::semantic_graph::Relation;
use evermap_contract::{Emit, Fault, Key, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::Bytes;
use evermap_schemas::layers::{RelatedViews, View};

use crate::inputs::graphs::NumberedViews;

/// See the module's page.
pub struct RelationIndex;

impl Operator for RelationIndex {
    const NAME: &'static str = "relation_index";
    const VERSION: u32 = 1;
    const PAGE: &'static str = include_str!("relation_index.md");
    type Params = NothingToChoose;
    type Output = RelatedViews;

    fn work() -> Work<Self::Params> {
        Work::group(Port::site::<View>("views"), Key::SITE, vec![], related)
    }
}

fn related(
    _: &NothingToChoose,
    views: Vec<View>,
    _: Sides,
    emit: &mut Emit<'_>,
) -> Result<(), Fault> {
    let site = views[0].site.clone();
    let Some(NumberedViews {
        classes,
        names,
        graphs,
    }) = NumberedViews::of(views, emit)
    else {
        return Ok(());
    };
    let digest = names_digest(names.iter().map(String::as_str));
    let index = relation_index::RelationIndex::new(graphs.iter());
    let row = |((class, relation, other), views): ((u8, Relation, u8), &ViewSet)| RelatedViews {
        site: site.clone(),
        class: classes.name(class.into()).to_owned(),
        relation: relation.word().to_owned(),
        other: classes.name(other.into()).to_owned(),
        views: Bytes(views.to_bytes()),
        names: digest.clone(),
    };
    let mut rows: Vec<RelatedViews> = index.iter().map(row).collect();
    rows.sort_by(|a, b| (&a.class, &a.relation, &a.other).cmp(&(&b.class, &b.relation, &b.other)));
    emit.rows(rows)
}

#![doc = include_str!("class_index.md")]

use evermap_algorithms::semantic_map::relocation;
use evermap_contract::{Emit, Fault, Key, NothingToChoose, Operator, Port, Sides, Work};
use evermap_schemas::layers::{ClassCount, ClassLeaf, View};

use crate::inputs::graphs::NumberedViews;

/// See the module's page.
pub struct ClassIndex;

impl Operator for ClassIndex {
    const NAME: &'static str = "class_index";
    const VERSION: u32 = 2;
    const PAGE: &'static str = include_str!("class_index.md");
    type Params = NothingToChoose;
    type Output = ClassLeaf;

    fn work() -> Work<Self::Params> {
        Work::group(Port::site::<View>("views"), Key::SITE, vec![], leaves)
    }
}

fn leaves(
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
    let index = relocation::ClassIndex::new(graphs.iter(), classes.len());
    let rows = (0..index.len()).map(|leaf| {
        let (counts, views) = index.leaf(leaf);
        let present = counts.iter().enumerate().filter(|(_, areas)| **areas > 0);
        ClassLeaf {
            site: site.clone(),
            leaf: leaf as u32,
            counts: present
                .map(|(class, areas)| ClassCount {
                    class: classes.name(class).to_owned(),
                    areas: *areas,
                })
                .collect(),
            views: views
                .iter()
                .map(|view| names[*view as usize].clone())
                .collect(),
        }
    });
    emit.rows(rows.collect())
}

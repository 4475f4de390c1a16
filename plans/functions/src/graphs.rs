//! The graph column, without copying it.

use arrow::array::{
    Array, ArrayRef, AsArray, BooleanArray, Float32Array, ListArray, StringArray, StructArray,
    UInt16Array,
};
use arrow::datatypes::{DataType, Float32Type, UInt16Type, UInt32Type};
use datafusion::common::{DataFusionError, Result, plan_err};

/// A column of graphs, as `evermap_schemas::layers::SemanticGraph` declares it.
pub(crate) struct Graphs<'a> {
    column: &'a StructArray,
    areas: &'a ListArray,
    classes: &'a StringArray,
}

/// What positions and contacts need beside the classes.
pub(crate) struct Geometry<'a> {
    widths: &'a [u32],
    wraps: &'a BooleanArray,
    u: &'a Float32Array,
    v: &'a Float32Array,
    edges: &'a ListArray,
    a: &'a UInt16Array,
    b: &'a UInt16Array,
}

/// Whether a type is that of a graph column.
pub(crate) fn is_graph(data_type: &DataType) -> bool {
    let DataType::Struct(fields) = data_type else {
        return false;
    };
    fields.find("areas").is_some() && fields.find("edges").is_some()
}

/// A plain sentence for an argument that is no graph.
pub(crate) fn no_graph<T>(function: &str, found: &DataType) -> Result<T> {
    plan_err!(
        "{function} expects a graph first, such as the column graph of the layer views, found {found}"
    )
}

fn member<'a>(parent: &'a StructArray, name: &str) -> Result<&'a ArrayRef> {
    parent.column_by_name(name).ok_or_else(|| {
        DataFusionError::Execution(format!(
            "expected a graph with {name}; columns of views are described by `evermap layers`"
        ))
    })
}

fn mistyped(name: &str) -> DataFusionError {
    DataFusionError::Execution(format!(
        "expected a graph column as the layer views has it; {name} is of another type"
    ))
}

fn list<'a>(parent: &'a StructArray, name: &str) -> Result<(&'a ListArray, &'a StructArray)> {
    let list = member(parent, name)?
        .as_list_opt::<i32>()
        .ok_or_else(|| mistyped(name))?;
    let items = list
        .values()
        .as_struct_opt()
        .ok_or_else(|| mistyped(name))?;
    Ok((list, items))
}

impl<'a> Graphs<'a> {
    pub(crate) fn of(column: &'a ArrayRef) -> Result<Self> {
        let column = column.as_struct_opt().ok_or_else(|| mistyped("graph"))?;
        let (areas, items) = list(column, "areas")?;
        let classes = member(items, "class")?;
        Ok(Self {
            column,
            areas,
            classes: classes.as_string_opt().ok_or_else(|| mistyped("class"))?,
        })
    }

    pub(crate) fn geometry(&self) -> Result<Geometry<'a>> {
        let (_, areas) = list(self.column, "areas")?;
        let (edges, ends) = list(self.column, "edges")?;
        let number = |name| {
            member(areas, name)?
                .as_primitive_opt::<Float32Type>()
                .ok_or_else(|| mistyped(name))
        };
        let end = |name| {
            member(ends, name)?
                .as_primitive_opt::<UInt16Type>()
                .ok_or_else(|| mistyped(name))
        };
        let widths = member(self.column, "width")?.as_primitive_opt::<UInt32Type>();
        Ok(Geometry {
            widths: widths.ok_or_else(|| mistyped("width"))?.values(),
            wraps: member(self.column, "wraps")?
                .as_boolean_opt()
                .ok_or_else(|| mistyped("wraps"))?,
            u: number("u")?,
            v: number("v")?,
            edges,
            a: end("a")?,
            b: end("b")?,
        })
    }

    pub(crate) fn len(&self) -> usize {
        self.column.len()
    }

    pub(crate) fn is_null(&self, row: usize) -> bool {
        self.column.is_null(row)
    }

    /// Indices of a row's areas in the list of all areas.
    pub(crate) fn areas(&self, row: usize) -> std::ops::Range<usize> {
        range(self.areas, row)
    }

    /// The class of an area.
    pub(crate) fn class(&self, area: usize) -> &'a str {
        self.classes.value(area)
    }
}

impl Geometry<'_> {
    /// Full circle in pixels, where the row's view is one.
    pub(crate) fn circle_px(&self, row: usize) -> Option<f32> {
        self.wraps.value(row).then(|| self.widths[row] as f32)
    }

    /// Centre of an area (px).
    pub(crate) fn centre(&self, area: usize) -> [f32; 2] {
        [self.u.value(area), self.v.value(area)]
    }

    /// Pairs of areas of a row that touch, by their indices within the row.
    pub(crate) fn contacts(&self, row: usize) -> impl Iterator<Item = [usize; 2]> {
        let ends = move |edge: usize| [self.a.value(edge), self.b.value(edge)].map(usize::from);
        range(self.edges, row).map(ends)
    }
}

fn range(list: &ListArray, row: usize) -> std::ops::Range<usize> {
    let offsets = list.value_offsets();
    offsets[row] as usize..offsets[row + 1] as usize
}

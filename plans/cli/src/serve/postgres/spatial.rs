//! What PostGIS's clients write that queries of maps say otherwise: casts to geometries, boxes, the extent of a layer; and
//! what Postgres' clients do: members of nested columns, casts to types that are texts here.

use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    AccessExpr, BinaryOperator, Expr, Function, FunctionArg, FunctionArgExpr, FunctionArguments,
    Statement, Value, visit_expressions_mut,
};

use crate::output::GEOMETRY;
use crate::serve::postgres::expression::expression;
use crate::serve::postgres::functions::{UUID_IN, UUIDS_IN};

/// The statement in words that queries of maps have.
///
/// - What is cast to a geometry is one: text is well-known text, and an empty one is null.
/// - `ST_SetSRID` changes nothing, as there is no reference system; nor does that of `ST_MakeEnvelope`.
/// - `a && b` asks whether the rectangles of two geometries meet; `'BOX3D(…)'::box3d` is one.
/// - `ST_Extent` is the rectangle of a whole layer, as the text `BOX(…)`.
/// - `user` is `session_user`; `(pose).x` is a member of a nested column.
/// - What is cast to `json`, `jsonb`, `name` and the like is a text; to `uuid`, one as Postgres writes it.
/// - `GeometryType` and `ST_Zmflag` are asked of our functions.
pub fn in_our_words(mut statement: Statement) -> Statement {
    let _ = visit_expressions_mut(&mut statement, |found| {
        if let Some(same) = same(found) {
            *found = same;
        }
        ControlFlow::<()>::Continue(())
    });
    statement
}

fn same(found: &Expr) -> Option<Expr> {
    match found {
        Expr::Cast {
            expr, data_type, ..
        } => {
            let name = data_type.to_string().to_lowercase();
            match name.as_str() {
                GEOMETRY => Some(geometry(expr)),
                "box2d" | "box3d" => rectangle(text(expr)?),
                _ => as_text(expr, &name),
            }
        }
        Expr::Function(call) if matches!(call.args, FunctionArguments::None) => {
            let is_user = call.name.to_string().eq_ignore_ascii_case("user");
            is_user.then(|| expression("session_user"))?
        }
        Expr::Function(call) => match call.name.to_string().to_lowercase().as_str() {
            "st_setsrid" => argument(call).cloned(),
            "st_makeenvelope" => without_system(call),
            "st_extent" => extent(argument(call)?),
            "geometrytype" => expression(&format!(
                "upper(replace(st_geometrytype({}), 'ST_', ''))",
                argument(call)?
            )),
            "st_zmflag" => expression(&format!(
                "CASE WHEN st_astext({}) LIKE '% Z(%' THEN 2 ELSE 0 END",
                argument(call)?
            )),
            "regclass" => number_of_table(argument(call)?),
            _ => None,
        },
        Expr::CompoundFieldAccess { root, access_chain } => member(root, access_chain),
        Expr::BinaryOp {
            left,
            op: BinaryOperator::PGOverlap,
            right,
        } => expression(&format!(
            "st_intersects(st_envelope({left}), st_envelope({right}))"
        )),
        _ => None,
    }
}

/// What is cast to a type, of this name, whose values are texts here, or to lists of such.
fn as_text(of: &Expr, kind: &str) -> Option<Expr> {
    let (item, list) = match kind.strip_suffix("[]") {
        Some(item) => (item, "[]"),
        None => (kind, ""),
    };
    let text = format!("CAST({of} AS TEXT{list})");
    match item.strip_prefix("pg_catalog.").unwrap_or(item) {
        "uuid" if list.is_empty() => expression(&format!("{UUID_IN}({text})")),
        "uuid" => expression(&format!("{UUIDS_IN}({text})")),
        "json" | "jsonb" | "name" | "bpchar" | "character varying" => expression(&text),
        _ => None,
    }
}

/// A member of what stands between brackets, by its name.
fn member(root: &Expr, chain: &[AccessExpr]) -> Option<Expr> {
    let (Expr::Nested(of), [AccessExpr::Dot(Expr::Identifier(name))]) = (root, chain) else {
        return None;
    };
    let name = name.value.replace('\'', "''");
    expression(&format!("get_field({of}, '{name}')"))
}

fn text(value: &Expr) -> Option<&str> {
    match value {
        Expr::Value(value) => match &value.value {
            Value::SingleQuotedString(text) => Some(text),
            _ => None,
        },
        _ => None,
    }
}

fn argument(call: &Function) -> Option<&Expr> {
    let FunctionArguments::List(list) = &call.args else {
        return None;
    };
    match list.args.first()? {
        FunctionArg::Unnamed(FunctionArgExpr::Expr(first)) => Some(first),
        _ => None,
    }
}

/// A rectangle whose reference system is said.
fn without_system(call: &Function) -> Option<Expr> {
    let mut call = call.clone();
    let FunctionArguments::List(list) = &mut call.args else {
        return None;
    };
    if list.args.len() != 5 {
        return None;
    }
    list.args.pop();
    Some(Expr::Function(call))
}

/// The number of a table, by its name with or without a schema.
fn number_of_table(name: &Expr) -> Option<Expr> {
    let part = |number: i8| format!("replace(split_part({name}, '.', {number}), '\"', '')");
    let (schema, table) = (part(1), part(-1));
    expression(&format!(
        "(SELECT min(c.oid) FROM pg_catalog.pg_class c JOIN pg_catalog.pg_namespace n ON c.relnamespace = n.oid \
         WHERE c.relname = {table} AND (strpos({name}, '.') = 0 OR n.nspname = {schema}))"
    ))
}

fn geometry(of: &Expr) -> Expr {
    let made = text(of).and_then(|text| match text.trim_end().ends_with("EMPTY") {
        true => Some(Expr::Value(Value::Null.into())),
        false => expression(&format!("st_geomfromtext({of})")),
    });
    made.unwrap_or_else(|| of.clone())
}

/// `BOX3D(1 2, 3 4)`, or with heights, as a geometry.
fn rectangle(text: &str) -> Option<Expr> {
    let (_, corners) = text.trim_end().strip_suffix(')')?.split_once('(')?;
    let (low, high) = corners.split_once(',')?;
    let corner = |corner: &str| -> Option<[f64; 2]> {
        let mut numbers = corner.split_whitespace().map(str::parse);
        Some([numbers.next()?.ok()?, numbers.next()?.ok()?])
    };
    let ([west, south], [east, north]) = (corner(low)?, corner(high)?);
    expression(&format!(
        "st_makeenvelope({west:?}, {south:?}, {east:?}, {north:?})"
    ))
}

fn extent(of: &Expr) -> Option<Expr> {
    expression(&format!(
        "'BOX(' || min(st_xmin({of})) || ' ' || min(st_ymin({of})) || ',' || max(st_xmax({of})) || ' ' \
         || max(st_ymax({of})) || ')'"
    ))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
    use datafusion::sql::sqlparser::parser::Parser;

    #[test]
    fn what_postgis_has_words_for_is_said_in_ours() {
        for (theirs, ours) in [
            (
                "SELECT ST_SRID('POINT EMPTY'::GEOMETRY)",
                "SELECT ST_SRID(NULL)",
            ),
            (
                "SELECT geometry::geometry, 'POINT(1 2)'::geometry FROM lanes",
                "SELECT geometry, st_geomfromtext('POINT(1 2)') FROM lanes",
            ),
            (
                "SELECT 1 FROM lanes WHERE \"geometry\" && ST_SetSRID('BOX3D(-1 -1e6, 50 2)'::box3d, -2)",
                "SELECT 1 FROM lanes WHERE st_intersects(st_envelope(\"geometry\"), \
                 st_envelope(st_makeenvelope(-1.0, -1000000.0, 50.0, 2.0)))",
            ),
            (
                "SELECT geometrytype(geometry) FROM lanes WHERE geometry && st_makeenvelope(1, 2, 3, 4, 0)",
                "SELECT upper(replace(st_geometrytype(geometry), 'ST_', '')) FROM lanes WHERE \
                 st_intersects(st_envelope(geometry), st_envelope(st_makeenvelope(1, 2, 3, 4)))",
            ),
            (
                "SELECT (p.map_from_vehicle).x, (a) FROM poses p",
                "SELECT get_field(p.map_from_vehicle, 'x'), (a) FROM poses p",
            ),
            (
                "SELECT $1::uuid, CAST(site AS uuid[]), site::jsonb, $2::json[], site::name, site::pg_catalog.name, \
                 CAST(site AS character varying), $3::regclass",
                "SELECT uuid_in(CAST($1 AS TEXT)), uuids_in(CAST(site AS TEXT[])), CAST(site AS TEXT), \
                 CAST($2 AS TEXT[]), CAST(site AS TEXT), CAST(site AS TEXT), CAST(site AS TEXT), $3::REGCLASS",
            ),
            (
                "SELECT 1 && 2, 'BOX(forged)'::box3d, x::text FROM t",
                "SELECT st_intersects(st_envelope(1), st_envelope(2)), 'BOX(forged)'::box3d, x::TEXT FROM t",
            ),
        ] {
            let statement = Parser::parse_sql(&PostgreSqlDialect {}, theirs).unwrap();
            let said = in_our_words(statement.into_iter().next().unwrap());
            assert_eq!(said.to_string(), ours);
        }
    }
}

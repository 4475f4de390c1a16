#![allow(clippy::unwrap_used, clippy::panic)]

use datafusion::prelude::SessionContext;
use evermap_schemas::layers::{SemanticArea, SemanticEdge, SemanticGraph, View};
use evermap_schemas::{LayerRow, Stamp, batch};

use crate::register;

/// A view 100 px wide all around, with areas of these classes at these centres and these contacts.
pub(crate) fn view(name: &str, areas: &[(&str, f32, f32)], edges: &[(u16, u16)]) -> View {
    let area = |(class, u, v): &(&str, f32, f32)| SemanticArea {
        class: (*class).to_owned(),
        pixels: 50,
        u: *u,
        v: *v,
        major_px: 5.0,
        minor_px: 4.0,
        orientation_rad: 0.0,
        eccentricity: 0.6,
    };
    let edge = |(a, b): &(u16, u16)| SemanticEdge {
        a: *a,
        b: *b,
        boundary_px: 7,
    };
    View {
        site: "street".into(),
        session: "monday".into(),
        stamp: Stamp(0),
        camera: "roof".into(),
        view: name.into(),
        graph: SemanticGraph {
            width: 100,
            height: 30,
            wraps: true,
            field_of_view_rad: None,
            areas: areas.iter().map(area).collect(),
            edges: edges.iter().map(edge).collect(),
        },
        map_from_view: None,
        depth: None,
    }
}

pub(crate) fn views() -> Vec<View> {
    vec![
        view(
            "car",
            &[("road", 50.0, 25.0), ("car", 52.0, 20.0)],
            &[(0, 1)],
        ),
        view(
            "sign above",
            &[("road", 50.0, 25.0), ("sign", 50.0, 5.0)],
            &[],
        ),
        view(
            "houses",
            &[
                ("building", 95.0, 10.0),
                ("building", 40.0, 10.0),
                ("tree", 3.0, 10.0),
            ],
            &[(0, 2)],
        ),
        view("nothing", &[], &[]),
    ]
}

pub(crate) fn context() -> SessionContext {
    let context = SessionContext::new();
    register(&context);
    context
        .register_batch(View::NAME, batch(views()).unwrap())
        .unwrap();
    context
}

pub(crate) async fn rows(context: &SessionContext, query: &str) -> Result<Vec<String>, String> {
    let frame = context
        .sql(query)
        .await
        .map_err(|error| error.to_string())?;
    let batches = frame.collect().await.map_err(|error| error.to_string())?;
    let mut rows = Vec::new();
    for batch in &batches {
        let names = batch.column(0);
        for row in 0..batch.num_rows() {
            rows.push(arrow::util::display::array_value_to_string(names, row).unwrap());
        }
    }
    rows.sort();
    Ok(rows)
}

async fn found(condition: &str) -> Vec<String> {
    let query = format!("SELECT view FROM views WHERE {condition}");
    rows(&context(), &query).await.unwrap()
}

#[tokio::test]
async fn views_are_found_by_what_they_show() {
    assert_eq!(found("contains(graph, 'building', 2)").await, ["houses"]);
    assert!(found("contains(graph, 'building', 3)").await.is_empty());
    let without = found("NOT contains(graph, 'car')").await;
    assert_eq!(without, ["houses", "nothing", "sign above"]);
    assert_eq!(found("contains(graph, 'tree', 0)").await.len(), 4);
    assert_eq!(found("contains(view, 'ou')").await, ["houses"]);
}

#[tokio::test]
async fn views_are_found_by_how_areas_lie() {
    assert_eq!(found("related(graph, 'car', 'on', 'road')").await, ["car"]);
    assert!(
        found("related(graph, 'sign', 'on', 'road')")
            .await
            .is_empty()
    );
    assert_eq!(
        found("related(graph, 'sign', 'above', 'road')").await,
        ["sign above"]
    );
    // Around the seam: 3 is eight columns right of 95.
    assert_eq!(
        found("related(graph, 'tree', 'right of', 'building')").await,
        ["houses"]
    );
    assert_eq!(
        found("related(graph, 'building', 'touches', 'tree')").await,
        ["houses"]
    );
    assert!(
        found("related(graph, 'road', 'left of', 'road')")
            .await
            .is_empty()
    );
}

#[tokio::test]
async fn what_makes_no_sense_is_said() {
    let context = context();
    for (condition, says) in [
        ("related(graph, 'car', 'upon', 'road')", "right of"),
        (
            "related(view, 'car', 'on', 'road')",
            "expects a graph first",
        ),
        ("contains(graph)", "contains expects"),
        ("contains(graph, 'car', 'many')", "whole number"),
    ] {
        let query = format!("SELECT view FROM views WHERE {condition}");
        let said = rows(&context, &query).await.unwrap_err();
        assert!(said.contains(says), "{condition}: {said}");
    }
}

#[tokio::test]
async fn every_function_is_documented_and_its_example_is_true() {
    let documented = crate::documented();
    assert_eq!(documented.len(), crate::functions().len());
    let context = context();
    for function in documented {
        let example = function.sql_example.unwrap();
        let (query, answer) = example.rsplit_once(" -- ").unwrap();
        assert_eq!(rows(&context, query).await.unwrap(), [answer], "{example}");
        assert!(
            function.description.contains(" → "),
            "{}",
            function.description
        );
        let name = function.syntax_example.split('(').next().unwrap();
        assert!(query.contains(&format!("{name}(")), "{example}");
    }
}

#[tokio::test]
async fn poses_of_messages_are_poses_and_nulls_are_null() {
    let context = context();
    let message = "named_struct('position', named_struct('x', 1.0, 'y', 2.0, 'z', 0.0),
        'orientation', named_struct('x', 0.0, 'y', 0.0, 'z', 1.0, 'w', 1.0))";
    for (query, expected) in [
        (format!("round(yaw({message}), 4)"), "1.5708"),
        (
            format!("round(transform({message}, 3, 0, 0)['y'], 4)"),
            "5.0",
        ),
        ("yaw(NULL)".to_owned(), ""),
        ("transform(pose(0, 0, 0, 0), NULL, 0, 0)".to_owned(), ""),
        ("pose(NULL, 0, 0, 0)".to_owned(), ""),
        ("compose(pose(0, 0, 0, 0), NULL)".to_owned(), ""),
        ("st_length(NULL)".to_owned(), ""),
        ("st_distance(st_point(0, 0), NULL)".to_owned(), ""),
        ("st_x(st_geomfromtext('LINESTRING(0 0, 1 1)'))".to_owned(), ""),
        (
            "st_astext(st_geomfromtext('GEOMETRYCOLLECTION(POINT(1 2),MULTIPOLYGON(((0 0,1 0,1 1,0 0))))'))"
                .to_owned(),
            "GEOMETRYCOLLECTION(POINT(1 2),MULTIPOLYGON(((0 0,1 0,1 1,0 0))))",
        ),
    ] {
        let answer = rows(&context, &format!("SELECT {query}")).await.unwrap();
        assert_eq!(answer, [expected], "{query}");
    }
}

#[tokio::test]
async fn polygons_cut_polygons_and_lines() {
    let context = context();
    let floor = "st_makeenvelope(0, 0, 4, 3)";
    let lane = "st_geomfromtext('LINESTRING(-1 1, 6 1, 6 2, 2 2)')";
    for (query, expected) in [
        (
            format!("st_area(st_intersection({floor}, st_makeenvelope(2, 1, 9, 9)))"),
            "4.0",
        ),
        (
            format!("st_length(st_intersection({floor}, {lane}))"),
            "6.0",
        ),
        (format!("st_length(st_difference({lane}, {floor}))"), "6.0"),
        (
            format!("st_astext(st_difference({lane}, st_makeenvelope(-9, -9, 9, 9)))"),
            "MULTILINESTRING EMPTY",
        ),
        (format!("st_intersection({lane}, NULL)"), ""),
    ] {
        let answer = rows(&context, &format!("SELECT {query}")).await.unwrap();
        assert_eq!(answer, [expected], "{query}");
    }
    for (call, says) in [
        (
            format!("st_intersection({lane}, {lane})"),
            "expected polygons, found a line",
        ),
        (
            format!("st_difference({floor}, {lane})"),
            "expected polygons, found a line",
        ),
        (
            format!("st_union({floor}, st_point(1, 1))"),
            "found a point",
        ),
    ] {
        let said = rows(&context, &format!("SELECT {call}")).await.unwrap_err();
        assert!(said.contains(says), "{call}: {said}");
    }
}

#[tokio::test]
async fn what_lies_in_a_tangle_is_not_asked_and_points_are_found_in_any_geometry() {
    let comb = |stands: bool| {
        let tooth = |at: u32| {
            let at = f64::from(at);
            [(at, 0.0), (at + 0.2, 3_000.0), (at + 0.4, 0.0)]
        };
        let corners = (0..3_000).flat_map(tooth);
        let corners = corners.chain([(3_000.0, -1.0), (0.0, -1.0), (0.0, 0.0)]);
        let corners = corners.map(|(x, y)| match stands {
            true => format!("{x} {y}"),
            false => format!("{y} {x}"),
        });
        let corners: Vec<String> = corners.collect();
        format!("st_geomfromtext('POLYGON(({}))')", corners.join(", "))
    };
    let (context, up, along) = (context(), comb(true), comb(false));
    for call in [
        format!("st_contains({up}, {along})"),
        format!("st_within({up}, {along})"),
    ] {
        let said = rows(&context, &format!("SELECT {call}")).await.unwrap_err();
        assert!(said.contains("at most 4000000 times"), "{said}");
    }
    let within = format!("SELECT st_contains({up}, st_point(0.2, 1))");
    assert_eq!(rows(&context, &within).await.unwrap(), ["true"]);
}

#[tokio::test]
async fn what_is_no_pose_or_geometry_is_refused() {
    let context = context();
    let brackets = "(".repeat(100_000);
    for (call, says) in [
        ("yaw('north')", "yaw expects (pose: a pose), found (text)"),
        ("yaw(pose(0, 0, 0, 0), 1)", "yaw expects (pose: a pose)"),
        ("pose(1, 2)", "or (x: a number"),
        (
            "yaw(pose(0, 0, 0, 0, 0, 0, 0))",
            "expected a unit quaternion",
        ),
        ("st_length(X'0102')", "found 2 other bytes"),
        ("st_geomfromtext('POINT(1')", "well-known text"),
        ("st_geomfromtext('POINT EMPTY')", "an empty point"),
        (
            &format!("st_geomfromtext('GEOMETRYCOLLECTION{brackets}')"),
            "too many brackets",
        ),
        ("st_area(st_point('NaN'::double, 0))", "finite numbers"),
    ] {
        let said = rows(&context, &format!("SELECT {call}")).await.unwrap_err();
        assert!(said.contains(says), "{call}: {said}");
    }
}

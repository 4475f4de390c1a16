//! What DataFusion does not plan where it stands, as people call it. It prints its own structures.

/// What no query may have where it stands, and what is written instead.
pub fn unplanned(message: &str) -> Option<(String, &'static str)> {
    let around = "expected a subquery without columns of the query around it, as this place has none for them";
    if message.contains("OuterReferenceColumn") {
        let next = match message.contains("data_type: List(") {
            true => {
                "take a list apart in a query of its table: FROM (SELECT landmark, unnest(sightings) AS s FROM landmarks)"
            }
            false => "write it as a join: the last row before a time is found by ASOF JOIN",
        };
        return Some((around.to_owned(), next));
    }
    if message.contains("logical expression WindowFunction(") {
        return Some((
            "expected no window function in GROUP BY, WHERE or a condition".to_owned(),
            "compute it in a query within: FROM (SELECT *, row_number() OVER (ORDER BY stamp) AS n FROM poses)",
        ));
    }
    if let Some((_, behind)) = message.split_once("Projections require unique expression names") {
        let name = behind.split('"').nth(1)?;
        let name = match name.rsplit_once(" AS ") {
            Some((_, alias)) if !alias.ends_with(')') => alias,
            _ => name,
        };
        return Some((
            format!("expected columns of different names, found two called {name}"),
            "name one of them with AS",
        ));
    }
    let (_, node) = message.split_once("Unsupported ast node ")?;
    let node = node.split(|c: char| !c.is_alphanumeric()).next()?;
    let next = match node {
        "Pivot" => "write a column for each value: sum(x) FILTER (WHERE class = 'car') AS car",
        "Unpivot" => "write a SELECT for each column, with UNION ALL between them",
        _ => "",
    };
    Some((format!("not supported: {}", node.to_uppercase()), next))
}

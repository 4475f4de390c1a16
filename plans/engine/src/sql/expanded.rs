//! How large a statement becomes on its way to a plan. A table of `WITH` is planned wherever it is named, so thirty that
//! name each other twice are a thousand million; `CUBE` groups by each choice of its columns.

use std::collections::BTreeMap;
use std::ops::ControlFlow;

use datafusion::sql::sqlparser::ast::{
    Expr, FunctionArg, FunctionArgExpr, FunctionArguments, GroupByExpr, ObjectName, Query, Select,
    Statement, Visit, Visitor,
};
use evermap_schemas::Fault;

use crate::sql::named::known;
use crate::sql::size::QUERY_WORDS;
use crate::sql::widths::CASTS;

/// Words and operators at most, once each table of `WITH` stands where it is named.
const EXPANDED_WORDS: u64 = 2 * QUERY_WORDS as u64;

/// Choices of columns that a query may group by at once, as in Postgres.
const GROUPINGS: u64 = 4096;

/// Types at most that a text names within each other: whatever reads it goes as deep.
const NESTED_TYPES: usize = 64;

/// Refuses a statement that would become too large.
///
/// # Errors
/// A user fault with both numbers.
pub fn check_expanded(statement: &Statement) -> Result<(), Fault> {
    let found = statement.visit(&mut Expanded::default()).break_value();
    found.map_or(Ok(()), Err)
}

/// The queries that are being read, the outermost first.
#[derive(Default)]
struct Expanded(Vec<Scope>);

/// A query.
#[derive(Default)]
struct Scope {
    /// Its words so far.
    words: u64,
    /// Tables of its `WITH` that were not read yet: where their queries are.
    coming: Vec<(*const Query, String)>,
    /// Those that were: their words.
    tables: BTreeMap<String, u64>,
}

impl Visitor for Expanded {
    type Break = Fault;

    fn pre_visit_query(&mut self, query: &Query) -> ControlFlow<Fault> {
        let tables = query.with.iter().flat_map(|with| &with.cte_tables);
        let coming = tables.map(|table| {
            let at: *const Query = &*table.query;
            (at, known(&table.alias.name))
        });
        self.0.push(Scope {
            coming: coming.collect(),
            ..Scope::default()
        });
        ControlFlow::Continue(())
    }

    fn post_visit_query(&mut self, query: &Query) -> ControlFlow<Fault> {
        let Some(Scope { words, .. }) = self.0.pop() else {
            return ControlFlow::Continue(());
        };
        if words > EXPANDED_WORDS {
            let said = "once each table of WITH stands where it is named";
            return ControlFlow::Break(
                Fault::user(format!(
                    "expected a query of at most {EXPANDED_WORDS} words and operators {said}, found {words}"
                ))
                .next("make a table of what is named often, as a step of a plan"),
            );
        }
        if let Some(outer) = self.0.last_mut() {
            let is_this = |(at, _): &(*const Query, String)| std::ptr::eq(*at, query);
            match outer.coming.iter().position(is_this) {
                Some(table) => {
                    let (_, name) = outer.coming.swap_remove(table);
                    outer.tables.insert(name, words);
                }
                None => outer.words = outer.words.saturating_add(words),
            }
        }
        ControlFlow::Continue(())
    }

    fn pre_visit_relation(&mut self, relation: &ObjectName) -> ControlFlow<Fault> {
        let name = match relation.0.as_slice() {
            [name] => name.as_ident().map(known),
            _ => None,
        };
        let known = name.and_then(|name| {
            let mut scopes = self.0.iter().rev();
            scopes.find_map(|scope| scope.tables.get(&name).copied())
        });
        self.add(known.unwrap_or(0).saturating_add(1));
        ControlFlow::Continue(())
    }

    fn pre_visit_expr(&mut self, expr: &Expr) -> ControlFlow<Fault> {
        // What a list is made of may be long.
        let is_listed = matches!(
            expr,
            Expr::Value(_) | Expr::Nested(_) | Expr::Tuple(_) | Expr::Array(_)
        );
        self.add(u64::from(!is_listed));
        match named_type(expr).map_or(0, |named| depth(&named)) {
            found if found > NESTED_TYPES => ControlFlow::Break(Fault::user(format!(
                "expected a type of at most {NESTED_TYPES} types within each other, found {found}"
            ))),
            _ => ControlFlow::Continue(()),
        }
    }

    fn pre_visit_select(&mut self, select: &Select) -> ControlFlow<Fault> {
        match groupings(&select.group_by) {
            found if found > GROUPINGS => ControlFlow::Break(
                Fault::user(format!(
                    "expected at most {GROUPINGS} choices of columns to group by, found {found}"
                ))
                .next("name those that are wanted: GROUPING SETS ((a, b), (a))"),
            ),
            _ => ControlFlow::Continue(()),
        }
    }
}

impl Expanded {
    fn add(&mut self, words: u64) {
        if let Some(scope) = self.0.last_mut() {
            scope.words = scope.words.saturating_add(words);
        }
    }
}

/// The text by which a function is told a type.
fn named_type(expr: &Expr) -> Option<String> {
    let Expr::Function(call) = expr else {
        return None;
    };
    let function = known(call.name.0.last()?.as_ident()?);
    let FunctionArguments::List(given) = &call.args else {
        return None;
    };
    match given.args.get(1)? {
        FunctionArg::Unnamed(FunctionArgExpr::Expr(Expr::Value(text)))
            if CASTS.contains(&function.as_str()) =>
        {
            text.value.clone().into_string()
        }
        _ => None,
    }
}

/// How deep the brackets of a text stand in each other.
fn depth(text: &str) -> usize {
    let (mut depth, mut most) = (0_usize, 0);
    for letter in text.bytes() {
        match letter {
            b'(' => depth += 1,
            b')' => depth = depth.saturating_sub(1),
            _ => {}
        }
        most = most.max(depth);
    }
    most
}

/// By how many choices of columns a query groups.
fn groupings(group_by: &GroupByExpr) -> u64 {
    let GroupByExpr::Expressions(by, _) = group_by else {
        return 1;
    };
    let choices = by.iter().map(|expr| match expr {
        Expr::Cube(columns) => match u32::try_from(columns.len()) {
            Ok(count @ 0..64) => 1 << count,
            _ => u64::MAX,
        },
        Expr::Rollup(columns) => columns.len() as u64 + 1,
        Expr::GroupingSets(sets) => sets.len() as u64,
        _ => 1,
    });
    choices.fold(1, u64::saturating_mul)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use crate::sql::{Limits, STACK_BYTES, context, read_only};

    /// Tables that each name the one before so many times.
    fn chain(tables: usize, times: usize) -> String {
        let joined = |n: usize| {
            let named = (0..times).map(|time| format!("c{n} AS t{time}"));
            named.collect::<Vec<_>>().join(" CROSS JOIN ")
        };
        let tables = (1..tables).map(|n| format!("c{n} AS (SELECT t0.a FROM {})", joined(n - 1)));
        let tables: Vec<String> = tables.collect();
        let last = tables.len();
        format!(
            "WITH c0 AS (SELECT 1 AS a), {} SELECT count(*) FROM c{last}",
            tables.join(", ")
        )
    }

    #[test]
    fn what_with_and_cube_make_exponentially_larger_is_refused_before_it_is_planned() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .build()
            .unwrap();
        let asked = std::thread::Builder::new()
            .stack_size(STACK_BYTES)
            .spawn(move || runtime.block_on(ask()));
        asked.unwrap().join().unwrap();
    }

    async fn ask() {
        let context = context(Limits::one_partition()).unwrap();
        let cube = |columns: usize| {
            let columns = (0..columns).map(|n| format!("c{n}"));
            columns.collect::<Vec<_>>()
        };
        let table = |columns: &[String]| {
            let values = columns.iter().map(|name| format!("1 AS {name}"));
            values.collect::<Vec<_>>().join(", ")
        };
        let grouped = |by: &dyn Fn(&str) -> String, columns: usize| {
            let columns = cube(columns);
            let (of, by) = (table(&columns), by(&columns.join(", ")));
            format!("SELECT count(*) FROM (SELECT {of}) AS t GROUP BY {by}")
        };
        let refused = [
            (chain(30, 2), "once each table of WITH"),
            (
                format!("EXPLAIN {}", chain(30, 2)),
                "once each table of WITH",
            ),
            (
                format!("SELECT * FROM ({}) AS inside", chain(16, 3)),
                "once each table of WITH",
            ),
            (
                grouped(&|by| format!("CUBE ({by})"), 20),
                "at most 4096 choices of columns to group by, found 1048576",
            ),
            (grouped(&|by| format!("CUBE ({by})"), 70), "at most 4096"),
            (
                grouped(&|by| format!("ROLLUP ({by}), CUBE ({by})"), 10),
                "found 11264",
            ),
            (
                format!("SELECT arrow_cast(NULL, '{}')", "List(".repeat(100_000)),
                "at most 64 types within each other, found 100000",
            ),
        ];
        for (query, said) in refused {
            let fault = read_only(&context, &query).await.err().unwrap().to_string();
            assert!(fault.contains(said), "{query}: {fault}");
        }
        let list = format!("{}Int64{}", "List(".repeat(20), ")".repeat(20));
        for query in [
            format!("SELECT arrow_cast(NULL, '{list}')"),
            chain(6, 2),
            chain(300, 1),
            grouped(&|by| format!("CUBE ({by})"), 6),
        ] {
            let planned = read_only(&context, &query).await;
            assert!(planned.is_ok(), "{query}: {:?}", planned.err());
        }
        let list = vec!["(1, 'a')"; 30_000].join(", ");
        let listed =
            format!("WITH v AS (SELECT * FROM (VALUES {list}) AS t (a, b)) SELECT * FROM v");
        read_only(&context, &listed).await.unwrap();
    }
}

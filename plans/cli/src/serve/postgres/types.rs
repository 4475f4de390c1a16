//! What asyncpg asks of types that it has not heard of, such as `geometry`. It follows arrays, domains and composites by a
//! recursion that the planner does not know. A map has lists of Postgres' own types, and types that are made of no others: of
//! these all is told at once.

use datafusion::sql::sqlparser::ast::Statement;
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::parser::Parser;

/// What asyncpg calls the table that it makes.
const ASKED: &str = "typeinfo_tree";

/// Its columns, of the types whose numbers a client binds.
const TOLD: &str = "SELECT t.oid AS oid, n.nspname AS ns, t.typname AS name, t.typtype AS kind, \
     CAST(NULL AS INT) AS basetype, t.typelem AS elemtype, t.typdelim AS elemdelim, CAST(NULL AS INT) AS range_subtype, \
     CAST(NULL AS TEXT) AS attrtypoids, CAST(NULL AS TEXT[]) AS attrnames, CAST(0 AS INT) AS depth, \
     CAST(NULL AS TEXT) AS basetype_name, CASE WHEN t.typelem <> 0 THEN format_type(t.typelem, t.typtypmod) END AS elemtype_name, \
     CAST(NULL AS TEXT) AS range_subtype_name \
     FROM pg_catalog.pg_type t JOIN pg_catalog.pg_namespace n ON n.oid = t.typnamespace \
     WHERE array_has(CAST($1 AS INT[]), t.oid)";

/// The statement, or what asks the same in words that are understood.
pub fn of_types(statement: Statement) -> Statement {
    if !asks_for_types(&statement) {
        return statement;
    }
    let told = Parser::parse_sql(&PostgreSqlDialect {}, TOLD);
    let told = told.ok().and_then(|mut told| told.pop());
    told.unwrap_or(statement)
}

/// Whether it is that question. Its only value is a list of numbers of types, and is to be told as one: of a list of other
/// numbers asyncpg would have to ask in turn.
pub fn asks_for_types(statement: &Statement) -> bool {
    let Statement::Query(query) = statement else {
        return false;
    };
    let Some(with) = &query.with else {
        return false;
    };
    let mut tables = with.cte_tables.iter();
    with.recursive && tables.any(|table| table.alias.name.value == ASKED)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn parsed(text: &str) -> Statement {
        let mut parsed = Parser::parse_sql(&PostgreSqlDialect {}, text).unwrap();
        parsed.remove(0)
    }

    #[test]
    fn types_are_asked_for_as_they_are_told_and_all_else_as_it_is_written() {
        let asked = "WITH RECURSIVE typeinfo_tree(oid, depth) AS (SELECT oid, 0 FROM pg_catalog.pg_type WHERE \
             oid = any($1::oid[]) UNION ALL SELECT t.oid, tt.depth + 1 FROM pg_type t, typeinfo_tree tt \
             WHERE t.oid = tt.oid) SELECT DISTINCT *, oid::regtype::text AS name FROM typeinfo_tree ORDER BY depth DESC";
        assert_eq!(of_types(parsed(asked)), parsed(TOLD));
        for other in [
            "WITH RECURSIVE mine AS (SELECT 1 AS n UNION ALL SELECT n + 1 FROM mine WHERE n < 3) SELECT * FROM mine",
            "SELECT oid FROM pg_catalog.pg_type AS typeinfo_tree",
        ] {
            assert_eq!(of_types(parsed(other)), parsed(other));
        }
    }
}

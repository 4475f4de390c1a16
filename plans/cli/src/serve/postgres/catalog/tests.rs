#![allow(clippy::unwrap_used)]

use super::*;
use datafusion::sql::sqlparser::dialect::PostgreSqlDialect;
use datafusion::sql::sqlparser::parser::Parser;

fn parsed(text: &str) -> Statement {
    Parser::parse_sql(&PostgreSqlDialect {}, text)
        .unwrap()
        .remove(0)
}

#[test]
fn only_what_asks_for_postgres_own_tables_alone_is_of_the_catalog() {
    for (text, expected) in [
        ("SELECT 1 FROM pg_catalog.pg_class", true),
        (
            "SELECT 1 FROM pg_index i JOIN information_schema.tables t ON true",
            true,
        ),
        ("WITH x AS (SELECT 1 FROM pg_class) SELECT * FROM x", true),
        ("SELECT 1 FROM pg_class, generate_series(1, 2)", true),
        ("SELECT 1 FROM lanes, generate_series(1, 2)", false),
        ("SELECT 1 FROM lanes", false),
        ("SELECT 1 FROM pg_class, lanes", false),
        (
            "SELECT (SELECT max(x) FROM landmarks) FROM pg_catalog.pg_class",
            false,
        ),
        ("SELECT 1", false),
    ] {
        assert_eq!(is_of_catalog(&parsed(text)), expected, "{text}");
    }
}

#[test]
fn lists_of_what_is_not_there_are_null_and_columns_keep_their_names() {
    let query = parsed(
        "SELECT r.rolname, ARRAY(SELECT 1 FROM pg_roles b) AS memberof, NULL, NULL, f(1) FROM pg_roles r",
    );
    let without = in_its_words(query.clone()).to_string();
    assert!(without.contains("NULL::TEXT[] AS memberof"), "{without}");
    let looked_up =
        parsed("SELECT oid FROM pg_catalog.pg_proc WHERE proname = 'pg_catalog.array_in'");
    let bare = in_its_words(looked_up).to_string();
    assert!(bare.ends_with("proname = 'array_in'"), "{bare}");
    let asked = parsed(
        "SELECT (SELECT c.relkind = 'c' FROM pg_class c WHERE c.oid = t.typrelid), (SELECT count(*) FROM pg_am), \
         (SELECT $1::INT FROM pg_catalog.pg_attrdef WHERE adnum = $2) \
         FROM pg_type t WHERE t.typname LIKE 'a/_%' ESCAPE '/'",
    );
    let plain = in_its_words(asked).to_string();
    for part in [
        "(SELECT max(c.relkind = 'c') FROM pg_class",
        "(SELECT count(*) FROM pg_am), CASE WHEN false THEN concat($1::INT, $2::TEXT) END",
        "LIKE replace('a/_%', '/', '\\')",
    ] {
        assert!(plain.contains(part), "{plain}");
    }
    assert!(!plain.contains("ESCAPE"), "{plain}");
    let plan = no_rows(&query).unwrap();
    let names: Vec<_> = plan
        .schema()
        .fields()
        .iter()
        .map(|field| field.name().as_str())
        .collect();
    assert_eq!(
        names,
        ["rolname", "memberof", "?column?", "?column?", "?column?"]
    );
    assert!(no_rows(&parsed("SELECT * FROM pg_roles")).is_none());
    assert!(no_rows(&parsed("SELECT relname FROM pg_class")).is_none());
}

#[test]
fn of_keys_nobody_is_told_that_there_are_none() {
    let described =
        "SELECT c.conname FROM pg_constraint c LEFT JOIN pg_description d ON d.objoid = c.oid";
    for (asked, has_answer) in [
        ("", false),
        (" WHERE c.contype = 'p'", false),
        (" WHERE c.contype = $1", false),
        (" WHERE c.contype = 'f' OR c.contype = 'p'", false),
        (" WHERE c.contype = 'f' AND c.conrelid = 7", true),
        (" WHERE contype = 'f'::TEXT", true),
    ] {
        let query = parsed(&format!("{described}{asked}"));
        assert_eq!(no_rows(&query).is_some(), has_answer, "{query}");
    }
    let indexes = parsed("SELECT i.indexrelid FROM pg_index i JOIN pg_opclass o ON true");
    assert!(no_rows(&indexes).is_none());
}

#[test]
fn keys_are_asked_for_in_words_that_are_understood() {
    for (asked, understood) in [
        (
            "generate_subscripts(pg_catalog.pg_index.indkey, $1::INTEGER)",
            "unnest(range(0, array_length(pg_catalog.pg_index.indkey, $1::INTEGER)))",
        ),
        (
            "pg_catalog.generate_subscripts(conkey, 1)",
            "unnest(generate_series(1, array_length(conkey, 1)))",
        ),
        ("i.indisprimary = 't'", "i.indisprimary = true"),
        ("indisunique <> 'f'", "indisunique <> false"),
        ("relname = 't'", "relname = 't'"),
    ] {
        let found = in_its_words(parsed(&format!("SELECT {asked} FROM pg_index i")));
        assert_eq!(
            found.to_string(),
            format!("SELECT {understood} FROM pg_index i")
        );
    }
}

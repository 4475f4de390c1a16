#![allow(clippy::unwrap_used)]
use std::sync::Arc;

use super::*;
use arrow::array::{
    Array, ArrayRef, AsArray, DictionaryArray, IntervalMonthDayNanoArray, StringArray, StructArray,
};
use arrow::compute::concat_batches;
use arrow::datatypes::{Field, Int32Type, IntervalMonthDayNano};
use arrow::ipc::reader::FileReader;
use evermap_schemas::{Bytes, Kind, Pose, Stamp, record};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

record! {
    /// A row of every kind.
    #[layer("mixed", key(name))]
    pub struct Mixed {
        /// Text.
        name: String,
        /// Instant.
        stamp: Stamp,
        /// Perhaps a number.
        height_m: Option<f64>,
        /// A struct.
        pose: Pose,
        /// A list.
        counts: Vec<u32>,
        /// Bytes.
        png: Bytes,
    }
}

fn rows() -> RecordBatch {
    let row = |name: &str, height_m| Mixed {
        name: name.into(),
        stamp: Stamp(1_500_000_000_123_456_789),
        height_m,
        pose: Pose {
            x: 1.234_567_89,
            ..Pose::IDENTITY
        },
        counts: vec![1, 2],
        png: Bytes(vec![0xab; 300]),
    };
    batch(vec![
        row("a, \"b\"", Some(0.5)),
        row("c", None),
        row("d", Some(f64::NAN)),
    ])
    .unwrap()
}

async fn written(format: Format, batches: Vec<RecordBatch>) -> Vec<u8> {
    let mut sink = Sink::spooled(usize::MAX);
    let count = batches
        .iter()
        .map(|batch| batch.num_rows() as u64)
        .sum::<u64>();
    let stream = futures::stream::iter(batches.into_iter().map(Ok));
    assert_eq!(
        write(format, rows().schema(), stream, &mut sink)
            .await
            .unwrap(),
        count
    );
    sink.bytes()
}

async fn text(format: Format, batches: Vec<RecordBatch>) -> String {
    String::from_utf8(written(format, batches).await).unwrap()
}

#[tokio::test]
async fn json_is_one_array_whatever_the_batches() {
    let whole = text(Format::Json, vec![rows()]).await;
    let halves = text(
        Format::Json,
        vec![rows().slice(0, 1), rows().slice(1, 0), rows().slice(1, 2)],
    )
    .await;
    assert_eq!(whole, halves);
    assert!(whole.ends_with("]\n"));
    let value: serde_json::Value = serde_json::from_str(&whole).unwrap();
    assert_eq!(value.as_array().unwrap().len(), 3);
    assert_eq!(value[0]["name"], "a, \"b\"");
    assert_eq!(value[0]["pose"]["qw"], 1.0);
    assert_eq!(value[0]["counts"], serde_json::json!([1, 2]));
    assert_eq!(value[0]["stamp"], "2017-07-14T02:40:00.123456789Z");
    assert!(
        value[1].as_object().unwrap()["height_m"].is_null(),
        "nulls are said"
    );
    assert!(value[2]["height_m"].is_null(), "JSON knows no NaN");
    assert_eq!(text(Format::Json, vec![]).await, "[]\n");
}

#[tokio::test]
async fn csv_has_a_header_and_json_for_what_is_nested() {
    let text_ = text(Format::Csv, vec![rows().slice(0, 1), rows().slice(1, 1)]).await;
    let lines: Vec<_> = text_.lines().collect();
    assert_eq!(lines.len(), 3);
    assert_eq!(lines[0], "name,stamp,height_m,pose,counts,png");
    assert!(
        lines[1].starts_with(
            "\"a, \"\"b\"\"\",2017-07-14T02:40:00.123456789Z,0.5,\"{\"\"x\"\":1.23456789"
        ),
        "{}",
        lines[1]
    );
    assert!(lines[2].contains("\"[1,2]\""), "{}", lines[2]);
    assert_eq!(text(Format::Csv, vec![]).await.lines().count(), 1);
}

#[tokio::test]
async fn tables_are_whole_where_no_terminal_shows_them() {
    let table = text(Format::Table, vec![rows()]).await;
    assert!(table.contains("| 300 B "), "{table}");
    assert!(!table.contains('…') && !table.contains("abab"), "{table}");
    assert!(table.contains("qw: 1.0}"), "{table}");
    assert_eq!(
        text(Format::Table, vec![]).await.lines().count(),
        4,
        "a header without rows"
    );
}

#[test]
fn cells_are_cut_for_a_terminal_and_have_their_lines_where_they_are_asked_for() {
    let texts = [
        format!("{}\n{}", "a".repeat(40), "b".repeat(40)),
        "c".into(),
    ];
    let column: ArrayRef = Arc::new(StringArray::from(texts.to_vec()));
    let batch = RecordBatch::try_from_iter([("text", column)]).unwrap();
    let (long, other) = ("a".repeat(40), "b".repeat(40));
    for (how, expected) in [
        (Cells::Short, format!("{long} {}…", &other[..18])),
        (Cells::Long, format!("{long} {other}")),
        (Cells::Lines, format!("{long}\n{other}")),
    ] {
        let cells = readable::cells(&batch, how).unwrap();
        let cells = cells.column(0).as_string::<i32>();
        assert_eq!((cells.value(0), cells.value(1)), (expected.as_str(), "c"));
    }
}

#[tokio::test]
async fn parquet_reads_back_the_same() {
    let bytes = written(
        Format::Parquet,
        vec![rows().slice(0, 2), rows().slice(2, 1)],
    )
    .await;
    let reader = ParquetRecordBatchReaderBuilder::try_new(bytes::Bytes::from(bytes))
        .unwrap()
        .build()
        .unwrap();
    let found: Vec<RecordBatch> = reader.map(Result::unwrap).collect();
    let found = concat_batches(&found[0].schema(), &found).unwrap();
    assert_eq!(
        format!("{:?}", found.columns()),
        format!("{:?}", rows().columns())
    );
    assert_eq!(found.schema().field(0).name(), "name");
}

#[tokio::test]
async fn columns_that_parquet_has_no_type_for_are_refused_before_the_file_begins() {
    let interval = IntervalMonthDayNanoArray::from(vec![IntervalMonthDayNano::new(1, 2, 3)]);
    let member = Field::new("of", interval.data_type().clone(), true);
    let interval: ArrayRef = Arc::new(interval);
    let within = StructArray::from(vec![(Arc::new(member), Arc::clone(&interval))]);
    for column in [interval, Arc::new(within)] {
        let batch = RecordBatch::try_from_iter([("lane", Arc::clone(&column)), ("x", column)]);
        let batch = batch.unwrap();
        let mut sink = Sink::spooled(usize::MAX);
        let rows = futures::stream::iter([Ok(batch.clone())]);
        let refused = write(Format::Parquet, batch.schema(), rows, &mut sink).await;
        let Err(Failure::Fault(fault)) = refused else {
            unreachable!("{refused:?}")
        };
        let said = "Parquet has no type for column lane, ";
        assert!(fault.message.starts_with(said), "{fault}");
        assert_eq!(sink.bytes(), b"");
    }
}

#[tokio::test]
async fn arrow_reads_back_the_same_also_without_rows() {
    let read = |bytes| FileReader::try_new(std::io::Cursor::new(bytes), None).unwrap();
    let bytes = written(Format::Arrow, vec![rows().slice(0, 2), rows().slice(2, 1)]).await;
    let found: Vec<RecordBatch> = read(bytes).map(Result::unwrap).collect();
    let found = concat_batches(&rows().schema(), &found).unwrap();
    assert_eq!(found.schema(), rows().schema());
    assert_eq!(
        format!("{:?}", found.columns()),
        format!("{:?}", rows().columns())
    );
    let empty = read(written(Format::Arrow, vec![]).await);
    assert_eq!((empty.schema(), empty.count()), (rows().schema(), 0));
}

#[tokio::test]
async fn dictionaries_that_change_are_written_in_every_format_and_as_values_to_arrow() {
    let words = |words: &[&str]| -> ArrayRef {
        let words: DictionaryArray<Int32Type> = words.iter().copied().collect();
        Arc::new(words)
    };
    let batch = |of: &[&str]| {
        let member = Field::new("of", words(of).data_type().clone(), true);
        let member: ArrayRef = Arc::new(StructArray::from(vec![(Arc::new(member), words(of))]));
        RecordBatch::try_from_iter([("word", words(of)), ("member", member)]).unwrap()
    };
    let batches = [batch(&["a", "b", "a"]), batch(&["c"])];
    for format in FORMATS {
        let mut sink = Sink::spooled(usize::MAX);
        let rows = futures::stream::iter(batches.clone().map(Ok));
        let count = write(format, batches[0].schema(), rows, &mut sink).await;
        assert_eq!(count.unwrap(), 4, "{format:?}");
        let bytes = std::io::Cursor::new(sink.bytes());
        if format == Format::Arrow {
            let file = FileReader::try_new(bytes, None).unwrap();
            let found: Vec<RecordBatch> = file.map(Result::unwrap).collect();
            let found = concat_batches(&found[0].schema(), &found).unwrap();
            let expected = StringArray::from(vec!["a", "b", "a", "c"]);
            assert_eq!(found.column(0).as_string::<i32>(), &expected);
            let members = found.column(1).as_struct();
            assert_eq!(members.column(0).as_string::<i32>(), &expected);
        }
    }
}

#[tokio::test]
async fn rows_of_other_types_than_their_file_says_are_refused() {
    let numbers: ArrayRef = Arc::new(arrow::array::Float64Array::from(vec![5.0]));
    let texts: ArrayRef = Arc::new(StringArray::from(vec!["5"]));
    let said = RecordBatch::try_from_iter([("x", texts)]).unwrap().schema();
    let found = RecordBatch::try_from_iter([("x", numbers)]).unwrap();
    let mut sink = Sink::spooled(usize::MAX);
    let rows = futures::stream::iter([Ok(found)]);
    let failure = write(Format::Arrow, said, rows, &mut sink).await;
    let Err(Failure::Fault(fault)) = failure else {
        unreachable!("{failure:?}")
    };
    assert!(
        fault
            .message
            .contains("expected x of type Utf8, found Float64"),
        "{fault}"
    );
}

/// How writing rows to a sink goes wrong.
async fn refused(format: Format, mut sink: Sink) -> Fault {
    let stream = futures::stream::iter([Ok(rows())]);
    let written = write(format, rows().schema(), stream, &mut sink).await;
    let ended = match written {
        Ok(_) => sink.finish(),
        Err(failure) => Err(failure),
    };
    let Err(Failure::Fault(fault)) = ended else {
        unreachable!("{format:?}: {ended:?}")
    };
    fault
}

const FORMATS: [Format; 5] = [
    Format::Table,
    Format::Csv,
    Format::Json,
    Format::Parquet,
    Format::Arrow,
];

#[cfg(target_os = "linux")]
#[tokio::test]
async fn a_disk_that_is_full_is_told_so_in_every_format() {
    for format in FORMATS {
        let fault = refused(format, Sink::file(Path::new("/dev/full")).unwrap()).await;
        assert_eq!(fault.kind, Kind::Resource, "{format:?}: {fault}");
        let said = "cannot write the result: No space left on device";
        assert!(fault.message.starts_with(said), "{format:?}: {fault}");
    }
}

#[tokio::test]
async fn a_folder_of_temporary_files_that_is_gone_is_named_in_every_format() {
    for format in FORMATS {
        let sink = Sink::spooled_in("/no/such/folder".into(), 0);
        let fault = refused(format, sink).await;
        assert_eq!(fault.kind, Kind::Resource, "{format:?}: {fault}");
        let said = "cannot write a temporary file in /no/such/folder: ";
        assert!(fault.message.starts_with(said), "{format:?}: {fault}");
        assert!(fault.next.contains("TMPDIR"), "{format:?}: {fault}");
    }
    let mut sink = Sink::spooled_in("/no/such/folder".into(), 0);
    std::io::Write::write_all(&mut sink, b"little").unwrap();
    let Err(Failure::Fault(fault)) = sink.rewound() else {
        unreachable!("it was written")
    };
    assert!(fault.next.contains("/no/such/folder"), "{fault}");
}

/// Rows that are there at once are left all the same, between one batch and the next, and the half of a file goes with them.
#[tokio::test]
async fn who_stops_while_rows_are_written_leaves_no_file_behind() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("answer.csv");
    let writing = tokio::spawn(async move {
        let mut sink = Sink::file(&out)?;
        let rows = futures::stream::repeat(rows()).map(Ok).take(100_000);
        write(Format::Csv, self::rows().schema(), rows, &mut sink).await?;
        sink.finish()
    });
    tokio::task::yield_now().await;
    writing.abort();
    assert!(writing.await.unwrap_err().is_cancelled());
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
}

/// In a piece there are as many rows as are light, and a heavy one alone.
#[test]
fn heavy_batches_are_written_in_light_pieces() {
    let texts = [1, 5, 2, 9, 4, 4].map(|megabytes| "x".repeat(megabytes << 20));
    let texts = StringArray::from_iter_values(texts);
    let batch = RecordBatch::try_from_iter([("t", Arc::new(texts) as ArrayRef)]).unwrap();
    let lengths: Vec<usize> = pieces(batch.clone())
        .iter()
        .map(RecordBatch::num_rows)
        .collect();
    assert_eq!(lengths, [2, 1, 1, 1, 1]);
    let schema = batch.schema();
    assert_eq!(
        concat_batches(&schema, &pieces(batch.clone())).unwrap(),
        batch
    );
    assert_eq!(pieces(batch.slice(0, 2)).len(), 1);
    assert_eq!(pieces(RecordBatch::new_empty(schema)).len(), 1);
}

/// What a heavy row takes while it is written is asked for before, and given back.
#[tokio::test]
async fn a_heavy_row_is_asked_for_before_it_is_written() {
    let row = |megabytes: usize| {
        let text = StringArray::from_iter_values(["x".repeat(megabytes << 20)]);
        RecordBatch::try_from_iter([("t", Arc::new(text) as ArrayRef)]).unwrap()
    };
    let rows = [row(1), row(10), row(2)];
    for (format, times) in [
        (Format::Table, 7),
        (Format::Csv, 5),
        (Format::Json, 3),
        (Format::Parquet, 4),
    ] {
        let asked = std::sync::Mutex::new(Vec::new());
        let ask = |most: usize| {
            let stream = futures::stream::iter(rows.clone().map(Ok));
            let asked = &asked;
            let copy = move |bytes: usize| {
                asked.lock().unwrap().push(bytes);
                match bytes > most {
                    true => Err(evermap_schemas::Fault::resource("too heavy")),
                    false => Ok(()),
                }
            };
            async move {
                let mut sink = Sink::spooled(usize::MAX);
                write_within(format, row(1).schema(), stream, &mut sink, copy).await
            }
        };
        assert_eq!(ask(usize::MAX).await.unwrap(), 3);
        let asked_for: Vec<usize> = asked.lock().unwrap().drain(..).collect();
        let (copied, others): (Vec<usize>, Vec<usize>) =
            asked_for.iter().partition(|bytes| **bytes > 0);
        assert_eq!((copied.len(), others.len()), (1, 3));
        assert!((copied[0] >> 20) == 10 * times, "{copied:?}");
        assert!(ask(9 << 20).await.is_err());
    }
}

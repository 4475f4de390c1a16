//! How heavy the values of columns and batches are, and batches cut by what their rows weigh.

use arrow::array::{Array, AsArray, GenericListArray, OffsetSizeTrait, RecordBatch};
use arrow::datatypes::DataType;

/// Bytes of the values of a column, of which it may be a slice: what lies beside it in its buffers is not counted.
pub fn bytes(column: &dyn Array) -> usize {
    let own = || {
        let sliced = column.to_data().get_slice_memory_size();
        sliced.unwrap_or_else(|_| column.get_array_memory_size())
    };
    match column.data_type() {
        DataType::Utf8View => own() + viewed(column.as_string_view().lengths()),
        DataType::BinaryView => own() + viewed(column.as_binary_view().lengths()),
        DataType::Struct(_) => {
            let members = column.as_struct().columns();
            members.iter().map(|member| bytes(member)).sum()
        }
        DataType::List(_) => bytes_of_lists(column.as_list::<i32>()),
        DataType::LargeList(_) => bytes_of_lists(column.as_list::<i64>()),
        DataType::Map(..) => {
            let map = column.as_map();
            let offsets = map.value_offsets();
            let (first, last) = (offsets[0] as usize, offsets[map.len()] as usize);
            size_of_val(offsets) + bytes(&map.entries().slice(first, last - first))
        }
        _ => own(),
    }
}

fn viewed(lengths: impl Iterator<Item = u32>) -> usize {
    lengths.map(|bytes| bytes as usize).sum()
}

fn bytes_of_lists<O: OffsetSizeTrait>(lists: &GenericListArray<O>) -> usize {
    let offsets = lists.value_offsets();
    let (first, last) = (offsets[0].as_usize(), offsets[lists.len()].as_usize());
    size_of_val(offsets) + bytes(&lists.values().slice(first, last - first))
}

/// Bytes of the values of a batch, as [`bytes()`] counts them.
pub fn weight(batch: &RecordBatch) -> usize {
    batch.columns().iter().map(|column| bytes(column)).sum()
}

/// A batch cut into pieces of rows that weigh at most so much together, or of one row with what weighs nothing around it. `rows`
/// says what each weighs.
pub fn pieces(
    batch: &RecordBatch,
    rows: impl IntoIterator<Item = u64>,
    most: u64,
) -> Vec<RecordBatch> {
    let (mut pieces, mut start, mut held) = (Vec::new(), 0, 0);
    for (row, more) in rows.into_iter().enumerate() {
        if held > 0 && held + more > most {
            pieces.push(batch.slice(start, row - start));
            (start, held) = (row, 0);
        }
        held += more;
    }
    pieces.push(batch.slice(start, batch.num_rows() - start));
    pieces
}

#[cfg(test)]
mod tests {
    use arrow::array::{BinaryViewArray, Int64Array, ListArray, StringArray};
    use arrow::datatypes::Int64Type;

    use super::*;

    #[test]
    fn slices_weigh_what_they_show() {
        assert_eq!(bytes(&Int64Array::from(vec![1; 100]).slice(10, 5)), 40);
        let texts = StringArray::from(vec!["ten bytes "; 100]);
        assert_eq!(bytes(&texts.slice(90, 10)), 100 + 4 * 11);
        let lists = (0..100).map(|_| Some((0..50).map(Some)));
        let lists = ListArray::from_iter_primitive::<Int64Type, _, _>(lists);
        // Validity is counted as well.
        let one = bytes(&lists.slice(7, 1));
        assert!((400..450).contains(&one), "{one}");
        assert!(bytes(&lists) > 40_000);
        let long = [1_u8; 1000];
        let views = BinaryViewArray::from_iter_values([&long[..]; 10]);
        assert!((3_000..3_100).contains(&bytes(&views.slice(2, 3))));
    }
}

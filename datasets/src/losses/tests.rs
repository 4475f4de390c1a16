use super::*;

#[test]
fn places_beyond_those_told_apart_are_summed_up() {
    let ledger = LossLedger::new();
    let file = ledger.of_file("a.mcap");
    for offset in 0..2 * MAX_PLACES as u64 {
        file.note(Reason::BadRecord, offset, Loss::one(2), "x");
    }
    assert_eq!(ledger.entries().len(), MAX_PLACES + 1);
    let expected = Loss {
        count: 2 * MAX_PLACES as u64,
        bytes: 4 * MAX_PLACES as u64,
    };
    assert_eq!(ledger.losses()[&Reason::BadRecord], expected);
}

/// Names of topics may be of a megabyte, and so may words be.
#[test]
fn texts_beyond_those_that_are_kept_are_summed_up_and_told_in_short() {
    let ledger = LossLedger::new();
    let file = ledger.of_file("a.mcap");
    let topic = "ä".repeat(100_000);
    for offset in 0..1000 {
        file.note_topic(Reason::Undecodable, &topic, offset, Loss::one(2), "x");
        file.note(Reason::BadRecord, offset, Loss::one(2), &*topic);
    }
    let kept: usize = ledger.entries().iter().map(text_bytes).sum();
    assert!(kept <= MAX_TEXT_BYTES + 4 * topic.len(), "{kept}");
    let expected = Loss {
        count: 1000,
        bytes: 2000,
    };
    assert!(ledger.losses().values().all(|loss| *loss == expected));
    let told = ledger.told();
    assert_eq!(told.values().copied().collect::<Vec<_>>(), [1000, 1000]);
    assert!(told.keys().all(|line| line.chars().count() == MAX_LINE + 1));
}

/// As many as a forged file may claim.
#[test]
fn sums_stay_at_the_most_that_there_is() {
    let most = Loss {
        count: u64::MAX,
        bytes: u64::MAX,
    };
    let mut sum = most;
    sum.add(Some(u64::MAX));
    assert_eq!(sum, most);
    let ledger = LossLedger::new();
    let file = ledger.of_file("a.mcap");
    for offset in 0..MAX_PLACES as u64 + 3 {
        file.note(Reason::BadSummary, offset, most, "x");
    }
    assert_eq!(ledger.losses()[&Reason::BadSummary], most);
    assert_eq!(ledger.told().into_values().collect::<Vec<_>>(), [u64::MAX]);
}

#[test]
fn a_person_is_told_topics_and_what_was_wrong_as_far_as_they_are_few() {
    let ledger = LossLedger::new();
    let file = ledger.of_file("a.mcap");
    file.note(Reason::Torn, 9, Loss::one(0), "");
    for topic in 0..2 * MAX_TOPICS {
        for offset in [1, 2] {
            let (topic, detail) = (format!("/t{topic:02}"), format!("x is {offset}"));
            file.note_topic(Reason::Senseless, &topic, offset, Loss::one(1), detail);
        }
    }
    let told = ledger.told();
    assert_eq!(told.len(), MAX_TOPICS + 2);
    assert_eq!(told["a.mcap: logs without an end"], 1);
    assert_eq!(
        told["a.mcap: messages with invalid values on /t03: x is 1"],
        2
    );
    let others = 2 * MAX_TOPICS as u64;
    assert_eq!(
        told["a.mcap: messages with invalid values on other topics"],
        others
    );
}

#[test]
fn a_place_that_is_read_twice_is_lost_once() {
    let ledger = LossLedger::new();
    let file = ledger.of_file("a.mcap");
    for bytes in [10, 30, 20] {
        file.note(Reason::BadChecksum, 7, Loss { count: 1, bytes }, "x");
    }
    file.note(Reason::BadChecksum, 8, Loss { count: 1, bytes: 1 }, "y");
    assert_eq!(
        ledger.losses()[&Reason::BadChecksum],
        Loss {
            count: 2,
            bytes: 31
        }
    );
    assert_eq!(ledger.lines(), ["2 chunks with a wrong checksum (31 B)"]);
    // What is found in addition at a place is told with it.
    let loss = Loss { count: 2, bytes: 1 };
    file.note(Reason::BadChecksum, 8, loss, "y and z");
    file.note(Reason::BadChecksum, 8, Loss::one(1), "y");
    assert_eq!(ledger.entries()[1].detail, "y and z");
}

#![allow(clippy::unwrap_used)]
use tokio::io::AsyncReadExt;

use super::*;

fn message(kind: &str, body: &[u8]) -> Vec<u8> {
    let size = i32::try_from(body.len() + 4).unwrap().to_be_bytes();
    [kind.as_bytes(), &size, body].concat()
}

fn hello() -> Vec<u8> {
    message("", b"\0\x03\0\0user\0ada\0database\0\0\0")
}

/// What is handed on of bytes that come `at_once` at a time, from somebody in or outside.
async fn handed_on(sent: &[u8], is_in: bool, at_once: usize) -> (Vec<u8>, io::Result<usize>) {
    let (mut client, server) = tokio::io::duplex(at_once);
    let sent = sent.to_vec();
    let sends = tokio::spawn(async move {
        use tokio::io::AsyncWriteExt;
        // Who is refused is not read to the end.
        let _ = client.write_all(&sent).await;
    });
    let mut checked = Checked::new(server, BytesMut::from(&hello()[..]));
    let mut greeting = vec![0; hello().len()];
    checked.read_exact(&mut greeting).await.unwrap();
    assert_eq!(greeting, hello());
    if is_in {
        checked.let_in();
    }
    let mut handed_on = Vec::new();
    let ended = checked.read_to_end(&mut handed_on).await;
    drop(checked);
    sends.await.unwrap();
    (handed_on, ended)
}

#[tokio::test]
async fn messages_are_handed_on_whole_however_they_come() {
    let bind = b"\0s\0\0\x01\0\x01\0\x02\0\0\0\x03abc\xff\xff\xff\xff\0\x01\0\0";
    let messages = [
        message("Q", b"SELECT 1\0"),
        message("P", b"s\0SELECT $1\0\0\x01\0\0\0\x19"),
        message("B", bind),
        message("D", b"Ss\0"),
        message("C", b"P\0"),
        message("E", b"\0\0\0\0\0"),
        message("H", b""),
        message("S", b""),
        message("Q", &[&[b'a'; 100_000][..], b"\0"].concat()),
        message("X", b""),
    ];
    for at_once in [1, 7, 1 << 20] {
        let (got, ended) = handed_on(&messages.concat(), true, at_once).await;
        ended.unwrap();
        assert_eq!(got, messages.concat());
    }
    // Half a message of somebody who is gone is nothing.
    let (got, ended) = handed_on(&messages.concat()[..20], true, 64).await;
    ended.unwrap();
    assert_eq!(got, messages[0]);
}

#[tokio::test]
async fn what_the_library_would_panic_at_or_take_for_two_messages_is_refused() {
    let sized = |kind: &str, size: i32| [kind.as_bytes(), &size.to_be_bytes()].concat();
    let wrong = [
        sized("S", 3),
        sized("p", 0),
        sized("d", -1),
        sized("Q", i32::MIN),
        sized("Q", FROM_INSIDE as i32 + 1),
        message("Q", b"SELECT 1"),
        message("Q", b"SELECT 1\0X"),
        message("P", b"s\0SELECT 1\0"),
        message("P", b"s\0SELECT 1\0\0"),
        message("P", b"s\0SELECT 1\0\0\x02\0\0\0\x19"),
        message("B", b"\0\0"),
        message("B", b"\0\0\0\0\0\x01\0\0\0\x09abc\0\0"),
        message("B", b"\0\0\0\0\0\x01\xff\xff\xff\xfe\0\0"),
        message("B", b"\0\0\0\0\0\0\0\x02\0\0"),
        message("B", b"\0\0\0\x02\0\0\0\0\0\x01\xff\xff\xff\xff\0\0"),
        message("C", b""),
        message("D", b"S"),
        message("E", b"\0\0\0\0"),
        message("S", b"\0"),
        message("X", b"more"),
        message("F", b"\0\0\0\x01"),
        b"GET / HTTP/1.1\r\n\r\n".to_vec(),
    ];
    for sent in wrong {
        let before = message("S", b"");
        let (got, ended) = handed_on(&[&before[..], &sent].concat(), true, 64).await;
        let error = ended.unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData, "{sent:?}");
        assert!(error.to_string().contains("expected a"), "{error}");
        assert_eq!(got, before, "{sent:?}");
    }
}

#[tokio::test]
async fn who_is_not_in_says_little_and_answers_in_form() {
    let long = message("Q", &[b'a'; FROM_OUTSIDE]);
    let (got, ended) = handed_on(&long, false, 64).await;
    assert!(got.is_empty() && ended.is_err());
    let proof = message("p", b"any bytes");
    let cases: [(&[u8], bool); 6] = [
        (b"SCRAM-SHA-256\0\0\0\0\x03abc", true),
        (b"SCRAM-SHA-256\0\xff\xff\xff\xff", true),
        (b"SCRAM-SHA-256\0\0\0\0\x04abc", false),
        (b"SCRAM-SHA-256\0\xff\xff\xff\xfe", false),
        (b"SCRAM-SHA-256\0", false),
        (b"", false),
    ];
    for (first, is_right) in cases {
        let sent = [message("p", first), proof.clone()].concat();
        let (got, ended) = handed_on(&sent, false, 64).await;
        assert_eq!(
            (got == sent, ended.is_ok()),
            (is_right, is_right),
            "{first:?}"
        );
    }
}

#[tokio::test]
async fn a_connection_begins_as_it_must() {
    let cancel = [&CANCEL[..], &[0_u8; 8]].concat();
    let cases: [(&[u8], bool); 7] = [
        (b"\0\x03\0\0\0", true),
        (&cancel, true),
        (b"\0\x03\0\0user\0ada\0", false),
        (b"\0\x03\0\0user\0", false),
        (b"\0\x03\0\0\0\0", false),
        (b"\0\x03", false),
        (b"", false),
    ];
    for (body, is_right) in cases {
        let sent = message("", body);
        let mut checked = Checked::new(tokio::io::empty(), BytesMut::from(&sent[..]));
        let mut got = Vec::new();
        let ended = checked.read_to_end(&mut got).await;
        assert_eq!(
            (got == sent, ended.is_ok()),
            (is_right, is_right),
            "{body:?}"
        );
    }
}

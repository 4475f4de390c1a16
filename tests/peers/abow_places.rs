//! ABoW (crates.io) behind the command line of our example `relocate`: compiled by `places.py`.
use abow::{BoW, Desc, Vocabulary};

fn read(name: &str) -> Vec<Vec<Desc>> {
    let bytes = std::fs::read(format!("{name}.features")).unwrap();
    let (mut views, mut at) = (Vec::new(), 0);
    while at < bytes.len() {
        let count = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let own = bytes[at + 4..at + 4 + 64 * count].chunks_exact(64);
        views.push(own.map(|one| one[..32].try_into().unwrap()).collect());
        at += 4 + 64 * count;
    }
    views
}

/// Seconds that this thread has been on a core: other work on the machine does not count. Linux only.
fn on_a_core_s() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text
        .split_whitespace()
        .next()
        .and_then(|word| word.parse::<f64>().ok());
    1e-9 * nanoseconds.unwrap_or(f64::NAN)
}

fn mean<T>(repeat: usize, mut run: impl FnMut() -> T) -> (f64, T) {
    let start = on_a_core_s();
    let results = (0..repeat).map(|_| run());
    let result = results.last().unwrap();
    ((on_a_core_s() - start) / repeat as f64, result)
}

fn main() {
    let words: Vec<String> = std::env::args().collect();
    let option = |name: &str| {
        let at = words.iter().position(|word| word == name).unwrap();
        words[at + 1].clone()
    };
    let (views, queries) = (read(&words[1]), read(&words[2]));
    let number = |name: &str| option(name).parse::<usize>().unwrap();
    let all: Vec<Desc> = views.iter().flatten().copied().collect();
    let (training_s, vocabulary) = mean(1, || {
        Vocabulary::create(&all, number("--branching"), number("--depth"))
    });
    let bag = |seen: &Vec<Desc>| vocabulary.transform(seen).unwrap();
    let map: Vec<BoW> = views.iter().map(bag).collect();
    let (words_s, bags) = mean(number("--repeat"), || {
        queries.iter().map(bag).collect::<Vec<_>>()
    });
    let (search_s, distances) = mean(number("--repeat"), || {
        let each = bags
            .iter()
            .flat_map(|bag| map.iter().map(|view| 1.0 - bag.l1(view)));
        each.collect::<Vec<f32>>()
    });
    let bytes: Vec<u8> = distances
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect();
    std::fs::write(option("--out"), bytes).unwrap();
    let each_us = |seconds: f64| 1e6 * seconds / queries.len() as f64;
    let report = serde_json::json!({
        "views": views.len(), "queries": queries.len(), "training_s": training_s,
        "words_us": each_us(words_s), "search_us": each_us(search_s),
    });
    println!("{report}");
}

//! The images among the messages of a recording, out of the logs of a map.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::sync::Arc;

use datafusion::execution::runtime_env::RuntimeEnv;
use evermap_datasets::ImageReader;
use evermap_schemas::Fault;

use super::messages::encoded;
use super::{Payload, TopicMessage, What};
use crate::reader::MapReader;

/// Logs that stay open: one drive comes after the other.
const MOST_LOGS: usize = 4;

/// The images of a map's logs.
pub struct Images<'r> {
    reader: &'r MapReader,
    runtime: Arc<RuntimeEnv>,
    logs: BTreeMap<String, ImageReader>,
}

impl<'r> Images<'r> {
    /// Of a map, whose logs are opened by a runtime.
    pub fn new(reader: &'r MapReader, runtime: Arc<RuntimeEnv>) -> Self {
        Self {
            reader,
            runtime,
            logs: BTreeMap::new(),
        }
    }

    /// Messages with the bytes of their images, in their order.
    ///
    /// # Errors
    /// A data fault for a log that is gone or damaged.
    pub async fn payloads<'s>(
        &mut self,
        said: &[&'s TopicMessage],
    ) -> Result<Vec<Cow<'s, Payload>>, Fault> {
        let mut pictures = self.read(said).await?.into_iter();
        let mut payload = |one: &&'s TopicMessage| match &one.what {
            What::Message(payload) => Ok(Cow::Borrowed(payload)),
            What::Image(image) => {
                let bytes = pictures.next().unwrap_or_default();
                Ok(Cow::Owned(encoded(&image.message(one.stamp, bytes))?))
            }
        };
        said.iter().map(&mut payload).collect()
    }

    /// The bytes of the images among these, in their order.
    async fn read(&mut self, said: &[&TopicMessage]) -> Result<Vec<Vec<u8>>, Fault> {
        let mut asked: BTreeMap<&str, Vec<(usize, _)>> = BTreeMap::new();
        let images = said.iter().filter_map(|one| match &one.what {
            What::Image(image) => Some(image),
            What::Message(_) => None,
        });
        let mut count = 0;
        for (place, image) in images.enumerate() {
            count += 1;
            let of_session = asked.entry(image.session.as_str()).or_default();
            of_session.push((place, image.reference.clone()));
        }
        let mut read = vec![Vec::new(); count];
        for (session, images) in asked {
            let (places, references): (Vec<usize>, Vec<_>) = images.into_iter().unzip();
            let found = self.log(session).await?.resolve(&references).await?;
            for (place, bytes) in places.into_iter().zip(found) {
                read[place] = bytes?.to_vec();
            }
        }
        Ok(read)
    }

    async fn log(&mut self, session: &str) -> Result<&ImageReader, Fault> {
        if !self.logs.contains_key(session) {
            if self.logs.len() >= MOST_LOGS {
                self.logs.clear();
            }
            let log = self.reader.map.log(session, &self.runtime).await?;
            let gone = || Fault::data(format!("the map has no log of session {session}"));
            let images = ImageReader::new(&log.ok_or_else(gone)?, ImageReader::CACHE_BYTES);
            self.logs.insert(session.to_owned(), images);
        }
        let log = self.logs.get(session);
        log.ok_or_else(|| Fault::bug("a log that was opened is not there"))
    }
}

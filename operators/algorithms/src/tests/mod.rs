//! What the tests of several families share.

pub(crate) mod shared_data;

//! A drive's poses in a map it did not make.

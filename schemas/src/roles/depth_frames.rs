//! Range images: 16-bit, in units that the log's maker chose (mostly mm), 0 where there is none.

use crate::roles::frames::{Content, Frame, IMAGES, of_content};
use crate::roles::{Messages, Role, every};

/// Image topics whose names speak of depth.
pub const ROLE: Role = Role::of::<Frame>(Messages {
    choose: |topics| every(&of_content(topics, Content::Depth)),
    ..IMAGES
})
.named(
    "depth_frames",
    "One range image of one camera, by reference.",
);

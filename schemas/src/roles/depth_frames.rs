//! Range images: of 16 bits in units that the log's maker chose (mostly mm), 0 where nothing was measured and 65,535 where
//! all there is is beyond range; or of floating-point metres (REP 118), NaN where nothing was measured and +∞ beyond range.

use crate::roles::content::Content;
use crate::roles::frames::{Frame, IMAGES, before_rectified, of_content};
use crate::roles::{Messages, Role};

/// Image topics whose names speak of depth.
pub const ROLE: Role = Role::of::<Frame>(Messages {
    choose: |topics| before_rectified(&of_content(topics, Content::Depth)),
    pictures: false,
    ..IMAGES
})
.named(
    "depth_frames",
    "One range image of one camera, by reference.",
);

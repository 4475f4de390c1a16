//! The binary `evermap-video`: decodes frames of video for `evermap`, which starts it where it meets them.

fn main() -> std::io::Result<()> {
    evermap_ffmpeg::serve(std::io::stdin().lock(), std::io::stdout().lock())
}

//! The binary `evermap-video`: decodes frames of video for `evermap`, which starts it where it meets them.

fn main() -> std::process::ExitCode {
    match evermap_ffmpeg::serve(std::io::stdin().lock(), std::io::stdout().lock()) {
        Ok(()) => std::process::ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: evermap-video answers requests of evermap alone: {error}");
            std::process::ExitCode::FAILURE
        }
    }
}

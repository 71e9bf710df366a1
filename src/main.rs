//! The program: all of it is in [`meldscope::cli`].

fn main() -> std::process::ExitCode {
    meldscope::cli::main()
}

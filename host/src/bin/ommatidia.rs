//! The `ommatidia` program.

fn main() -> std::process::ExitCode {
    ommatidia_host::cli::main()
}

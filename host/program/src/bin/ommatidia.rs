//! The `ommatidia` program.

fn main() -> std::process::ExitCode {
    ommatidia::cli::main()
}

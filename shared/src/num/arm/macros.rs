//! Macros of the routines in assembly: lists of clobbered registers, instructions, and blocks of conversions.

/// `asm!` that clobbers s0-s15, which callers do not expect to be kept.
macro_rules! asm_low {
    ($($item:tt)*) => {
        core::arch::asm!(
            $($item)*
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
            options(nostack)
        )
    };
}

/// `asm!` that clobbers every vector register.
macro_rules! asm_all {
    ($($item:tt)*) => {
        core::arch::asm!(
            $($item)*
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
            out("d8") _, out("d9") _, out("d10") _, out("d11") _,
            out("d12") _, out("d13") _, out("d14") _, out("d15") _,
            options(nostack)
        )
    };
}

/// One instruction of an `asm!` template: its name and its operands.
macro_rules! op {
    ($name:literal $first:literal $($operand:literal)*) => {
        concat!($name, " ", $first, $(", ", $operand,)* "\n")
    };
}

/// Widens the eight halves in four registers into eight registers.
macro_rules! widen_eight {
    (
        $from0:literal $from1:literal $from2:literal $from3:literal =>
        $to0:literal $to1:literal $to2:literal $to3:literal $to4:literal $to5:literal $to6:literal $to7:literal
    ) => {
        concat!(
            op!("vcvtb.f32.f16" $to0 $from0),
            op!("vcvtt.f32.f16" $to1 $from0),
            op!("vcvtb.f32.f16" $to2 $from1),
            op!("vcvtt.f32.f16" $to3 $from1),
            op!("vcvtb.f32.f16" $to4 $from2),
            op!("vcvtt.f32.f16" $to5 $from2),
            op!("vcvtb.f32.f16" $to6 $from3),
            op!("vcvtt.f32.f16" $to7 $from3),
        )
    };
}

/// Rounds the singles s0 to s7 to eight halves in four registers.
macro_rules! narrow_eight {
    ($to0:literal $to1:literal $to2:literal $to3:literal) => {
        concat!(
            op!("vcvtb.f16.f32" $to0 "s0"),
            op!("vcvtt.f16.f32" $to0 "s1"),
            op!("vcvtb.f16.f32" $to1 "s2"),
            op!("vcvtt.f16.f32" $to1 "s3"),
            op!("vcvtb.f16.f32" $to2 "s4"),
            op!("vcvtt.f16.f32" $to2 "s5"),
            op!("vcvtb.f16.f32" $to3 "s6"),
            op!("vcvtt.f16.f32" $to3 "s7"),
        )
    };
}

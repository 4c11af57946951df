//! Types of the numbers in files of frames, and how their bytes become f32.

use super::layout::SampleType;

/// Type of a number in a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    U8,
    I8,
    U16,
    I16,
    U32,
    I32,
    F32,
    F64,
}

impl Number {
    /// Size of one number, bytes.
    pub fn bytes(self) -> usize {
        match self {
            Self::U8 | Self::I8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::I32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The sample type that holds its values: its own, else float32.
    pub fn samples(self) -> SampleType {
        match self {
            Self::U8 => SampleType::U8,
            Self::U16 => SampleType::U16,
            _ => SampleType::F32,
        }
    }

    /// Values of numbers that lie one after another, each rounded to the nearest f32. Bytes after the last whole number
    /// count for nothing.
    pub fn decode(self, bytes: &[u8], big_endian: bool) -> Vec<f32> {
        /// Values of numbers of N bytes.
        fn values<const N: usize>(bytes: &[u8], big_endian: bool, value: impl Fn([u8; N]) -> f32) -> Vec<f32> {
            let (numbers, _) = bytes.as_chunks::<N>();
            let little = |number: &[u8; N]| {
                let mut number = *number;
                if big_endian {
                    number.reverse();
                }
                value(number)
            };
            numbers.iter().map(little).collect()
        }
        match self {
            Self::U8 => bytes.iter().map(|b| f32::from(*b)).collect(),
            Self::I8 => bytes.iter().map(|b| f32::from(*b as i8)).collect(),
            Self::U16 => values(bytes, big_endian, |b| f32::from(u16::from_le_bytes(b))),
            Self::I16 => values(bytes, big_endian, |b| f32::from(i16::from_le_bytes(b))),
            Self::U32 => values(bytes, big_endian, |b| u32::from_le_bytes(b) as f32),
            Self::I32 => values(bytes, big_endian, |b| i32::from_le_bytes(b) as f32),
            Self::F32 => values(bytes, big_endian, f32::from_le_bytes),
            Self::F64 => values(bytes, big_endian, |b| f64::from_le_bytes(b) as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_either_byte_order_become_f32() {
        assert_eq!(Number::U8.decode(&[200], true), [200.0]);
        assert_eq!(Number::I8.decode(&[200], false), [-56.0]);
        assert_eq!(Number::U16.decode(&[1, 2, 3], false), [513.0]);
        assert_eq!(Number::U16.decode(&[1, 2], true), [258.0]);
        assert_eq!(Number::I16.decode(&(-2i16).to_be_bytes(), true), [-2.0]);
        assert_eq!(Number::U32.decode(&70_000u32.to_le_bytes(), false), [70_000.0]);
        assert_eq!(Number::I32.decode(&(-70_000i32).to_be_bytes(), true), [-70_000.0]);
        assert_eq!(Number::F32.decode(&1.5f32.to_be_bytes(), true), [1.5]);
        assert_eq!(Number::F64.decode(&0.1f64.to_le_bytes(), false), [0.1f32]);
    }
}

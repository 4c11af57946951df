//! The layers of the network and the order of their weights.

use crate::blob;

/// A layer that has weights.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Layer {
    /// 3x3, 4 C -> W.
    Head,
    /// Convolution `conv` (0 or 1) of an RCAB, 3x3, W -> W.
    BlockConv {
        /// Group.
        group: u8,
        /// Block in the group.
        block: u8,
        /// First (0) or second (1).
        conv: u8,
    },
    /// First layer of a block's channel attention, 1x1, W -> W/r.
    Squeeze {
        /// Group.
        group: u8,
        /// Block in the group.
        block: u8,
    },
    /// Second layer of a block's channel attention, 1x1, W/r -> W.
    Excite {
        /// Group.
        group: u8,
        /// Block in the group.
        block: u8,
    },
    /// Convolution at the end of a group, 3x3, W -> W.
    GroupConv {
        /// Group.
        group: u8,
    },
    /// `conv1`, before the long skip, 3x3, W -> W.
    Conv1,
    /// Before the pixel shuffle, 3x3, W -> 4 W.
    Upscale,
    /// `conv2`, 3x3, W -> 1.
    Conv2,
}

/// One layer of the weight section: `outputs * inputs * kernel^2` weights `[out, in, ky, kx]`, then `outputs` biases.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Which layer.
    pub layer: Layer,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// Side of the kernel: 3 or 1.
    pub kernel: usize,
}

impl Entry {
    /// Number of weights.
    pub const fn weights_len(&self) -> usize {
        self.outputs * self.inputs * self.kernel * self.kernel
    }

    /// Number of biases.
    pub const fn bias_len(&self) -> usize {
        self.outputs
    }
}

/// The layers of a network with `channels` filters, in the order of their weights in the file.
pub fn layout(rcan: &blob::Rcan, channels: u8) -> impl Iterator<Item = Entry> + use<> {
    let rcan = *rcan;
    let (width, filters) = (usize::from(rcan.width), usize::from(channels));
    let hidden = hidden(&rcan);
    let entry = |layer, outputs, inputs, kernel| Entry { layer, outputs, inputs, kernel };
    let body = (0..rcan.groups).flat_map(move |group| {
        let blocks = (0..rcan.blocks).flat_map(move |block| {
            [
                entry(Layer::BlockConv { group, block, conv: 0 }, width, width, 3),
                entry(Layer::BlockConv { group, block, conv: 1 }, width, width, 3),
                entry(Layer::Squeeze { group, block }, hidden, width, 1),
                entry(Layer::Excite { group, block }, width, hidden, 1),
            ]
        });
        blocks.chain([entry(Layer::GroupConv { group }, width, width, 3)])
    });
    let tail = [
        entry(Layer::Conv1, width, width, 3),
        entry(Layer::Upscale, 4 * width, width, 3),
        entry(Layer::Conv2, 1, width, 3),
    ];
    [entry(Layer::Head, width, 4 * filters, 3)].into_iter().chain(body).chain(tail)
}

/// Number of weights and biases of the network, whatever its shape.
pub fn weights_count(rcan: &blob::Rcan, channels: u8) -> u64 {
    layout(rcan, channels).map(|entry| (entry.weights_len() + entry.bias_len()) as u64).sum()
}

/// Number of weights and biases of the channel attentions, which are halves in integer networks too.
pub(crate) fn attention_count(rcan: &blob::Rcan, channels: u8) -> u64 {
    let dense = layout(rcan, channels).filter(|entry| entry.kernel == 1);
    dense.map(|entry| (entry.weights_len() + entry.bias_len()) as u64).sum()
}

/// Length of the weight section of the network, halves; `usize::MAX`, which no slice has, where the machine's memory
/// cannot hold it.
pub fn weights_len(rcan: &blob::Rcan, channels: u8) -> usize {
    usize::try_from(weights_count(rcan, channels)).unwrap_or(usize::MAX)
}

/// Width W/r of the bottleneck of the attention. 0 where the reduction is 0 or above the width, which no network may
/// have.
pub const fn hidden(rcan: &blob::Rcan) -> usize {
    match rcan.width.checked_div(rcan.reduction) {
        Some(hidden) => hidden as usize,
        None => 0,
    }
}

//! A message type, compiled to a flat list of steps.
//!
//! CDR alignment makes offsets depend on the lengths before them, but between
//! two variable-length members they are static. Such a stretch is one
//! [`Step::Block`]: one alignment, one bounds check, then plain copies. Members
//! outside the projection leave no copies, so what is skipped costs an addition.

use crate::buffers::{Node, Target};
use crate::views::Views;
use crate::wire::{Extensibility, StructType, Wire};

/// How scalars and structs are laid out on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Dialect {
    /// Values align to their size, but at most to this: 8 in CDR, 4 in CDR2, 1 in ROS 1.
    pub(crate) max_align: usize,
    /// Strings carry a terminator that their length includes.
    pub(crate) terminated: bool,
    /// An empty struct takes one byte.
    pub(crate) empty_byte: bool,
    /// Lengths stand before collections of anything but numbers (CDR2).
    pub(crate) cdr2: bool,
    /// Structs that state nothing are appendable: a length stands before them.
    pub(crate) delimited: bool,
}

impl Dialect {
    pub(crate) const CDR: Dialect = Dialect {
        max_align: 8,
        terminated: true,
        empty_byte: true,
        cdr2: false,
        delimited: false,
    };
    pub(crate) const CDR2: Dialect = Dialect {
        max_align: 4,
        cdr2: true,
        ..Dialect::CDR
    };
    pub(crate) const DELIMITED_CDR2: Dialect = Dialect {
        delimited: true,
        ..Dialect::CDR2
    };
    pub(crate) const ROS1: Dialect = Dialect {
        max_align: 1,
        terminated: false,
        empty_byte: false,
        ..Dialect::CDR
    };
}

/// A copy of `count` values of `width` bytes from `offset` in a block to a buffer.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Move {
    pub(crate) offset: usize,
    pub(crate) width: usize,
    pub(crate) count: usize,
    pub(crate) buffer: usize,
}

/// One instruction.
#[derive(Debug, Clone)]
pub(crate) enum Step {
    /// `size` bytes of static layout from the next multiple of `align`.
    Block {
        align: usize,
        size: usize,
        moves: Vec<Move>,
    },
    /// A string of bytes.
    Text { to: Option<Target> },
    /// A string of UTF-16 units.
    WideText { to: Option<Target> },
    /// A counted run of bytes.
    Octets { to: Option<Views> },
    /// A counted run of numbers of `width` bytes.
    Run {
        width: usize,
        align: usize,
        to: Option<Target>,
    },
    /// A counted list; the next `body` steps are one element of at least `min_size` bytes.
    Sequence {
        body: usize,
        min_size: u64,
        offsets: Option<usize>,
    },
    /// `count` times the next `body` steps.
    Repeat {
        body: usize,
        min_size: u64,
        count: usize,
    },
    /// A 32-bit length in bytes, then the next `body` steps within it.
    Delimited { body: usize },
    /// The bytes asked for: `size` of them, or a counted run.
    Here { size: Option<usize> },
}

/// Compiles one message type for one dialect.
pub(crate) struct Compiler {
    dialect: Dialect,
    steps: Vec<Step>,
    /// Whether the last step is a block that may grow.
    open: bool,
}

impl Compiler {
    /// The steps for `message`, filling the columns of those members that are not left out.
    pub(crate) fn message(dialect: Dialect, message: &StructType, to: &Node) -> Vec<Step> {
        let mut compiler = Compiler::new(dialect);
        compiler.body(message, to);
        compiler.steps
    }

    /// The steps that walk to the binary member at `path`; none where there is no such member.
    pub(crate) fn locate(
        dialect: Dialect,
        message: &StructType,
        path: &[&str],
    ) -> Option<Vec<Step>> {
        let mut compiler = Compiler::new(dialect);
        compiler.walk_to(message, path)?;
        Some(compiler.steps)
    }

    fn new(dialect: Dialect) -> Self {
        Compiler {
            dialect,
            steps: Vec::new(),
            open: false,
        }
    }

    fn walk_to(&mut self, message: &StructType, path: &[&str]) -> Option<()> {
        let (name, rest) = path.split_first()?;
        if self.is_delimited(message) {
            // Entering is reading the length; what follows is found before its end.
            self.block(4, 4, 1, None);
        }
        for (member, wire) in &message.members {
            if member != name {
                self.value(wire, Node::left_out());
                continue;
            }
            return match wire {
                Wire::Struct(inner) => self.walk_to(inner, rest),
                Wire::Sequence(item) if rest.is_empty() && item.is_octet() => {
                    self.push(Step::Here { size: None });
                    Some(())
                }
                Wire::Array(item, size) if rest.is_empty() && item.is_octet() => {
                    self.push(Step::Here { size: Some(*size) });
                    Some(())
                }
                _ => None,
            };
        }
        None
    }

    fn is_delimited(&self, message: &StructType) -> bool {
        let appendable = match message.extensibility {
            Extensibility::Unstated => self.dialect.delimited,
            Extensibility::Final => false,
            Extensibility::Appendable => true,
        };
        self.dialect.cdr2 && appendable
    }

    fn body(&mut self, message: &StructType, to: &Node) {
        let start = self
            .is_delimited(message)
            .then(|| self.enter(Step::Delimited { body: 0 }));
        if message.members.is_empty() && self.dialect.empty_byte {
            self.block(1, 1, 1, None);
        }
        for (index, (_, wire)) in message.members.iter().enumerate() {
            self.value(wire, to.member(index));
        }
        if let Some(start) = start {
            self.leave(start);
        }
    }

    fn value(&mut self, wire: &Wire, to: &Node) {
        match wire {
            Wire::Scalar(_) | Wire::Enumeration => {
                let width = wire.fixed_width().unwrap_or(1);
                self.block(width, width, 1, to.data());
            }
            Wire::Text => self.push(Step::Text { to: to.target() }),
            Wire::WideText => self.push(Step::WideText { to: to.target() }),
            Wire::Sequence(item) => self.sequence(item, to),
            Wire::Array(item, size) => self.array(item, *size, to),
            Wire::Struct(body) => self.body(body, to),
        }
    }

    fn sequence(&mut self, item: &Wire, to: &Node) {
        let around = self.enter_collection(item);
        if let (Some(width), None) = (item.fixed_width(), around) {
            if item.is_octet() {
                return self.push(Step::Octets { to: to.views() });
            }
            self.push(Step::Run {
                width,
                align: width.min(self.dialect.max_align),
                to: to.target(),
            });
            return;
        }
        let start = self.enter(Step::Sequence {
            body: 0,
            min_size: self.min_size(item),
            offsets: to.offsets(),
        });
        self.value(item, to.element());
        self.leave(start);
        if let Some(around) = around {
            self.leave(around);
        }
    }

    fn array(&mut self, item: &Wire, size: usize, to: &Node) {
        let around = self.enter_collection(item);
        if let Some(width) = item.fixed_width() {
            // Octets are one value of fixed size, other numbers a list.
            let data = to.data().or_else(|| to.element().data());
            self.block(width, width, size, data);
        } else {
            let start = self.enter(Step::Repeat {
                body: 0,
                min_size: self.min_size(item),
                count: size,
            });
            self.value(item, to.element());
            self.leave(start);
        }
        if let Some(around) = around {
            self.leave(around);
        }
    }

    /// CDR2 writes a length before collections whose elements are not primitive.
    fn enter_collection(&mut self, item: &Wire) -> Option<usize> {
        let mut innermost = item;
        while let Wire::Array(inner, _) = innermost {
            innermost = inner;
        }
        let bare = !self.dialect.cdr2 || matches!(innermost, Wire::Scalar(_));
        (!bare).then(|| self.enter(Step::Delimited { body: 0 }))
    }

    /// Adds `count` values of `width` bytes to the open block, or opens one.
    fn block(&mut self, align: usize, width: usize, count: usize, buffer: Option<usize>) {
        let align = align.min(self.dialect.max_align);
        if !self.grow_block(align, width, count, buffer) {
            self.push(Step::Block {
                align,
                size: 0,
                moves: Vec::new(),
            });
            self.open = true;
            self.grow_block(align, width, count, buffer);
        }
    }

    fn grow_block(
        &mut self,
        value_align: usize,
        width: usize,
        count: usize,
        buffer: Option<usize>,
    ) -> bool {
        let open = self.open;
        let Some(Step::Block { align, size, moves }) = self.steps.last_mut() else {
            return false;
        };
        if !open || value_align > *align {
            return false;
        }
        let offset = size.next_multiple_of(value_align);
        *size = offset.saturating_add(width.saturating_mul(count));
        moves.extend(buffer.map(|buffer| Move {
            offset,
            width,
            count,
            buffer,
        }));
        true
    }

    fn push(&mut self, step: Step) {
        self.open = false;
        self.steps.push(step);
    }

    fn enter(&mut self, step: Step) -> usize {
        self.push(step);
        self.steps.len() - 1
    }

    /// Closes what `enter` opened at `start`.
    fn leave(&mut self, start: usize) {
        self.open = false;
        let length = self.steps.len() - start - 1;
        if let Some(
            Step::Sequence { body, .. } | Step::Repeat { body, .. } | Step::Delimited { body },
        ) = self.steps.get_mut(start)
        {
            *body = length;
        }
    }

    /// Fewest bytes one value takes, without padding.
    fn min_size(&self, wire: &Wire) -> u64 {
        match wire {
            Wire::Scalar(_) | Wire::Enumeration => wire.fixed_width().unwrap_or(1) as u64,
            Wire::Text | Wire::WideText | Wire::Sequence(_) => 4,
            Wire::Array(item, size) => self.min_size(item).saturating_mul(*size as u64),
            Wire::Struct(body) if body.members.is_empty() => u64::from(self.dialect.empty_byte),
            Wire::Struct(body) => body
                .members
                .iter()
                .fold(0, |sum, (_, w)| sum.saturating_add(self.min_size(w))),
        }
    }
}

//! Circle detector on an ST NUCLEO-H743ZI board (STM32H743, Cortex-M7 at 400 MHz).
//!
//! | data | port |
//! |---|---|
//! | events, EVT 2.0 words, 6 Mbit/s (150 000 events per second) | USART2, PD6 |
//! | circle stream, 921 600 bit/s | USART3, PD8: the ST-LINK's virtual serial port, read by `evcal` |
//!
//! The sensor's bridge sends its words to USART2. DMA fills two buffers in turn while the third is processed; a
//! detection may take as long as filling two buffers (54 ms). Circles are sent by interrupt from a queue; a frame that
//! does not fit into the queue is counted and not sent.
#![no_std]
#![no_main]

use core::cell::RefCell;

use cortex_m::interrupt::{Mutex, free};
use evcal_core::sensor::Sensor;
use evcal_core::window::Progress;
use evcal_detector::{Pipeline, Settings, Source, Storage, row_bytes, row_count};
use heapless::spsc::{Consumer, Queue};
use panic_halt as _;
use static_cell::ConstStaticCell;
use stm32h7xx_hal::dma::dma::{DmaConfig, StreamsTuple};
use stm32h7xx_hal::dma::{PeripheralToMemory, Transfer};
use stm32h7xx_hal::pac::{self, interrupt};
use stm32h7xx_hal::prelude::*;
use stm32h7xx_hal::serial::Tx;

/// Size of a DMA buffer in bytes: 4096 words.
const BUFFER: usize = 16 * 1024;
/// Size of the output queue in bytes: about five windows of circles.
const QUEUE: usize = 8192;
/// The sensor is a GenX320.
const SENSOR: Sensor = Sensor { width: 320, height: 320 };
/// Number of dots of the board.
const CIRCLES: u16 = 36;

static STORAGE: ConstStaticCell<Storage<{ row_bytes(320) }, { row_count(320) }, 4096, 256, 8000, 6400, 1024>> =
    ConstStaticCell::new(Storage::new());
static BUFFERS: [ConstStaticCell<[u8; BUFFER]>; 3] = [const { ConstStaticCell::new([0; BUFFER]) }; 3];
static OUTPUT: ConstStaticCell<Queue<u8, QUEUE>> = ConstStaticCell::new(Queue::new());
static SENDER: Mutex<RefCell<Option<Sender>>> = Mutex::new(RefCell::new(None));

/// State of the transmit interrupt.
struct Sender {
    bytes: Consumer<'static, u8>,
    port: Tx<pac::USART3>,
}

#[cortex_m_rt::entry]
fn main() -> ! {
    // Peripherals can be taken only once, and this is the first time. The clocks and pins below are constants, and they
    // are valid.
    let (Some(core), Some(device)) = (cortex_m::Peripherals::take(), pac::Peripherals::take()) else { halt() };
    let mut core = core;
    core.SCB.enable_icache();
    let power = device.PWR.constrain().freeze();
    let clocks = device.RCC.constrain().sys_ck(400.MHz()).pclk1(100.MHz()).freeze(power, &device.SYSCFG);
    let pins = device.GPIOD.split(clocks.peripheral.GPIOD);

    let (events_tx, events_rx) = (pins.pd5.into_alternate::<7>(), pins.pd6.into_alternate::<7>());
    let Ok(events) =
        device.USART2.serial((events_tx, events_rx), 6_000_000.bps(), clocks.peripheral.USART2, &clocks.clocks)
    else {
        halt()
    };
    let (circles_tx, circles_rx) = (pins.pd8.into_alternate::<7>(), pins.pd9.into_alternate::<7>());
    let Ok(circles) =
        device.USART3.serial((circles_tx, circles_rx), 921_600.bps(), clocks.peripheral.USART3, &clocks.clocks)
    else {
        halt()
    };

    let (mut output, bytes) = OUTPUT.take().split();
    free(|section| *SENDER.borrow(section).borrow_mut() = Some(Sender { bytes, port: circles.split().0 }));
    // SAFETY: the interrupt accesses shared data in critical sections.
    unsafe { cortex_m::peripheral::NVIC::unmask(pac::Interrupt::USART3) };
    let mut send = |frame: &[u8]| {
        if output.capacity() - output.len() < frame.len() {
            return false;
        }
        let sent = frame.iter().all(|&byte| output.enqueue(byte).is_ok());
        free(|section| {
            if let Some(sender) = SENDER.borrow(section).borrow_mut().as_mut() {
                sender.port.listen();
            }
        });
        sent
    };

    let [first, second, spare] = BUFFERS.each_ref().map(ConstStaticCell::take);
    let configuration = DmaConfig::default().memory_increment(true).double_buffer(true);
    let streams = StreamsTuple::new(device.DMA1, clocks.peripheral.DMA1);
    let mut transfer: Transfer<_, _, PeripheralToMemory, _, _> =
        Transfer::init(streams.0, events.split().1, first, Some(second), configuration);
    transfer.start(|port| port.enable_dma_rx());

    let settings = Settings::new("evcal NUCLEO-H743ZI", SENSOR, CIRCLES);
    let Ok(mut pipeline) = Pipeline::new(settings, STORAGE.take()) else { halt() };
    let mut source = Source::evt2();
    pipeline.announce(0, &mut send);
    let mut spare = spare;
    loop {
        // This fails until a buffer is full.
        let received = transfer.next_transfer_with(|full, _, _| (core::mem::replace(&mut spare, full), ()));
        if received.is_err() {
            continue;
        }
        let mut last_us = 0;
        for &byte in spare.iter() {
            let Some(event) = source.push(byte) else { continue };
            last_us = event.t;
            let mut progress = pipeline.push(event);
            while progress == Progress::Complete {
                pipeline.detect();
                progress = pipeline.report(&mut send);
            }
        }
        pipeline.count_undecodable(source.undecodable());
        pipeline.announce(last_us, &mut send);
    }
}

/// Sends queued bytes as long as the port accepts them.
#[interrupt]
fn USART3() {
    free(|section| {
        let mut sender = SENDER.borrow(section).borrow_mut();
        let Some(Sender { bytes, port }) = sender.as_mut() else { return };
        while let Some(&byte) = bytes.peek() {
            if port.write(byte).is_err() {
                return;
            }
            bytes.dequeue();
        }
        port.unlisten();
    });
}

/// Stops, because the program does not fit this board.
fn halt() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}

package dressi;

import java.nio.ByteBuffer;
import java.util.ArrayList;
import java.util.List;
import java.util.concurrent.atomic.AtomicBoolean;
import java.util.concurrent.locks.ReadWriteLock;
import java.util.concurrent.locks.ReentrantReadWriteLock;

/**
 * A bundle on a device: set inputs, step, get results. Calls of several threads run one after another; while one is in a bounded
 * {@link #step}, others begin between its chunks, in about 20 ms. {@link #close} waits for all of them. Errors are
 * {@link DressiException}s.
 */
public final class Session implements AutoCloseable {
    static {
        System.loadLibrary("dressi");
    }

    private final ReadWriteLock open = new ReentrantReadWriteLock(); // read: by calls; written: by close
    private long handle;

    private Session(long handle) {
        this.handle = handle;
    }

    /** Opens a file. {@code profile}: of several variants the one made for it, or null. {@code cache}: a folder for compiled pipelines
     *  (Context.getCodeCacheDir()), "off", or null. {@code pin}: the SHA-256 that the file must have, or null. */
    public static Session open(String path, Device device, String profile, String cache, String pin) {
        return new Session(open(path, null, 0, 0, device == null ? 0 : device.handle(), profile, cache, pin));
    }

    /** The same of the bytes between position and limit of a direct buffer, such as a mapped asset; they need not outlast the call. */
    public static Session open(ByteBuffer bundle, Device device, String profile, String cache, String pin) {
        long device0 = device == null ? 0 : device.handle();
        return new Session(open(null, bundle, bundle.position(), bundle.remaining(), device0, profile, cache, pin));
    }

    /** Every input, state and output, in the bundle's order. */
    public List<Value> values() {
        long session = begin();
        try {
            List<Value> found = new ArrayList<>();
            String[] name = new String[1];
            for (int[] about; (about = value(session, found.size(), name)) != null; ) found.add(new Value(name[0], about));
            return found;
        } finally {
            end();
        }
    }

    /** The value of this name, or null. */
    public Value find(String name) {
        for (Value value : values()) if (value.name.equals(name)) return value;
        return null;
    }

    /** Names of the phases, in the order of their schedule. */
    public List<String> phases() {
        long session = begin();
        try {
            List<String> found = new ArrayList<>();
            for (String name; (name = phase(session, found.size(), new long[1])) != null; ) found.add(name);
            return found;
        } finally {
            end();
        }
    }

    /** How often the schedule wants a phase run; 0: no wish. */
    public long steps(String phase) {
        long session = begin();
        try {
            long[] steps = new long[1];
            int k = 0;
            for (String name; (name = phase(session, k, steps)) != null; k++) if (name.equals(phase)) return steps[0];
            return 0;
        } finally {
            end();
        }
    }

    /** Gives an input or state the array between position and limit of a direct buffer. */
    public void set(String name, ByteBuffer array) {
        long session = begin();
        try {
            set(session, name, array, array.position(), array.remaining());
        } finally {
            end();
        }
    }

    /** Writes a value between position and limit of a direct buffer. */
    public void get(String name, ByteBuffer array) {
        long session = begin();
        try {
            get(session, name, array, array.position(), array.remaining());
        } finally {
            end();
        }
    }

    /** Runs n iterations of a phase (null: the current one) in one submission. */
    public void step(long n, String phase) {
        step(n, phase, -1, null);
    }

    /** Runs up to n iterations of a phase in chunks of about 20 ms: until so many seconds have gone by (negative: no bound) or {@code stop}
     *  (may be null) is true. How many were run. */
    public long step(long n, String phase, double seconds, AtomicBoolean stop) {
        long session = begin();
        try {
            return step(session, n, phase, seconds, stop);
        } finally {
            end();
        }
    }

    /** The loss of the current phase at the current state. */
    public float loss() {
        long session = begin();
        try {
            return loss(session);
        } finally {
            end();
        }
    }

    /** What the session did and occupies, as a JSON object: device, driver, profile, variants, phase, runs, skipped, bytes. */
    public String report() {
        long session = begin();
        try {
            return report(session);
        } finally {
            end();
        }
    }

    /** Writes states, inputs and counters to a file, atomically. */
    public void checkpoint(String path) {
        long session = begin();
        try {
            checkpoint(session, path);
        } finally {
            end();
        }
    }

    /** Takes those of a checkpoint of the same bundle. */
    public void restore(String path) {
        long session = begin();
        try {
            restore(session, path);
        } finally {
            end();
        }
    }

    /** Gives everything back; waits for calls that run. Twice is fine. */
    @Override
    public void close() {
        open.writeLock().lock();
        try {
            long session = handle;
            handle = 0;
            if (session != 0) close(session);
        } finally {
            open.writeLock().unlock();
        }
    }

    private long begin() {
        open.readLock().lock();
        if (handle != 0) return handle;
        open.readLock().unlock();
        throw new IllegalStateException("the session is closed");
    }

    private void end() {
        open.readLock().unlock();
    }

    private static native long open(String path, ByteBuffer bytes, int offset, int size, long device, String profile, String cache,
            String pin);
    private static native void close(long session);
    private static native int[] value(long session, int k, String[] name);
    private static native String phase(long session, int k, long[] steps);
    private static native void set(long session, String name, ByteBuffer array, int offset, int bytes);
    private static native void get(long session, String name, ByteBuffer array, int offset, int bytes);
    private static native long step(long session, long n, String phase, double seconds, AtomicBoolean stop);
    private static native float loss(long session);
    private static native String report(long session);
    private static native void checkpoint(long session, String path);
    private static native void restore(long session, String path);
}

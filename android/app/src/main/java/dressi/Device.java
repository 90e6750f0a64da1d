package dressi;

/** A Vulkan device. Sessions on it are closed before it is. */
public final class Device implements AutoCloseable {
    static {
        System.loadLibrary("dressi");
    }

    private long handle;

    /** {@code select}: its number or a part of its name; null: the best there is. */
    public Device(String select) {
        handle = open(select);
    }

    public String name() {
        return name(handle());
    }

    public String driver() {
        return driver(handle());
    }

    /** What the device allows, as the JSON that {@code dressi-edge compile -p FILE} takes. {@code name}: 1 to 64 of a-z, 0-9 and _;
     *  {@code date}: like 2025-01-31. */
    public String profile(String name, String date) {
        return profile(handle(), name, date);
    }

    @Override
    public synchronized void close() {
        long open = handle;
        handle = 0;
        if (open != 0) close(open);
    }

    synchronized long handle() {
        if (handle == 0) throw new IllegalStateException("the device is closed");
        return handle;
    }

    private static native long open(String select);
    private static native void close(long device);
    private static native String name(long device);
    private static native String driver(long device);
    private static native String profile(long device, String name, String date);
}

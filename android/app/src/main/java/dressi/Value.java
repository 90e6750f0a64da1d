package dressi;

import java.nio.ByteBuffer;
import java.nio.ByteOrder;

/** An input, state or output of a bundle: arrays of float, or of int, in row-major order. */
public final class Value {
    public static final int IN = 0, STATE = 1, OUT = 2;

    public final String name;
    public final int role, channels;
    public final boolean isInt;
    final int[] shape;

    Value(String name, int[] about) {
        this.name = name;
        role = about[0];
        isInt = about[1] != 0;
        channels = about[2];
        shape = new int[about.length - 3];
        System.arraycopy(about, 3, shape, 0, shape.length);
    }

    /** (), (channels), (count, channels), (height, width, channels) or (count, height, width, channels); the last is not there where there
     *  is one channel. */
    public int[] shape() {
        return shape.clone();
    }

    /** Of the whole array. */
    public int bytes() {
        long bytes = 4;
        for (int n : shape) bytes *= n;
        if (bytes > Integer.MAX_VALUE)
            throw new DressiException(DressiException.MEMORY, name + " has " + bytes + " bytes; a buffer has less");
        return (int) bytes;
    }

    /** A buffer for {@link Session#set} and {@link Session#get}. */
    public ByteBuffer buffer() {
        return ByteBuffer.allocateDirect(bytes()).order(ByteOrder.nativeOrder());
    }
}

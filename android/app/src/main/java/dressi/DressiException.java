package dressi;

/** What went wrong, in a sentence; {@link #code} tells the kinds apart. */
public final class DressiException extends RuntimeException {
    /** As in dressi.h. After LOST the session is closed; after all others it is as if the call had not been made. */
    public static final int MEMORY = 1, BUNDLE = 2, INPUT = 3, DEVICE = 4, LOST = 5;

    public final int code;

    DressiException(int code, String text) {
        super(text);
        this.code = code;
    }
}

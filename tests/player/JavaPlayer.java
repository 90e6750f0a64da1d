import dressi.Device;
import dressi.DressiException;
import dressi.Session;
import dressi.Value;
import java.io.IOException;
import java.nio.ByteBuffer;
import java.nio.channels.FileChannel;
import java.nio.file.Paths;
import java.nio.file.StandardOpenOption;
import java.util.concurrent.atomic.AtomicBoolean;

/** As player.c, through Java: {@code JavaPlayer DEVICE BUNDLE [DO WITH WHAT]...}; `file BUNDLE` and `mapped BUNDLE` say how it is opened. */
final class JavaPlayer {
    private static ByteBuffer load(String path) throws IOException {
        try (FileChannel file = FileChannel.open(Paths.get(path))) {
            ByteBuffer data = ByteBuffer.allocateDirect((int) file.size() + 3);
            data.position(3); // not at its beginning
            while (data.hasRemaining() && file.read(data) >= 0) {}
            data.flip();
            data.position(3);
            return data;
        }
    }

    private static void save(String path, ByteBuffer data) throws IOException {
        try (FileChannel file = FileChannel.open(Paths.get(path), StandardOpenOption.CREATE, StandardOpenOption.WRITE)) {
            file.write(data);
        }
    }

    private static void perform(Session session, String what, String with, String path) throws IOException {
        switch (what) {
            case "set": session.set(with, load(path)); break;
            case "get": {
                Value value = session.find(with);
                ByteBuffer data = value == null ? ByteBuffer.allocateDirect(4) : value.buffer();
                session.get(with, data);
                save(path, data);
                break;
            }
            case "step": session.step(Long.parseLong(path), with); break;
            case "bound": System.out.println(session.step(Long.parseLong(path), with, 0.2, null)); break;
            case "cancel": System.out.println(session.step(Long.parseLong(path), with, -1, new AtomicBoolean(true))); break;
            case "heap": session.set(with, ByteBuffer.allocate(Integer.parseInt(path))); break;
            case "loss": System.out.println(session.loss()); break;
            case "save": session.checkpoint(path); break;
            case "load": session.restore(path); break;
            case "report": System.out.println(session.report()); break;
            case "values":
                for (Value value : session.values()) System.out.println(value.name + " " + value.role + " " + value.isInt + " " + value.bytes());
                for (String phase : session.phases()) System.out.println(phase + " " + session.steps(phase));
                break;
            default: throw new IllegalArgumentException(what);
        }
    }

    public static void main(String[] words) throws IOException {
        try (Device device = new Device(words[0])) {
            boolean mapped = words[1].equals("mapped");
            Session session = mapped ? Session.open(load(words[2]), device, null, "off", null) : Session.open(words[2], device, null, "off", null);
            for (int k = 3; k < words.length; k += 3) {
                if (words[k].equals("capture")) {
                    System.out.print(device.profile(words[k + 1], words[k + 2]));
                    continue;
                }
                try {
                    perform(session, words[k], words[k + 1], words[k + 2]);
                } catch (DressiException error) {
                    System.out.println(error.code + " " + error.getMessage());
                }
            }
            session.close();
            session.close(); // twice is fine
            try {
                session.loss();
            } catch (IllegalStateException closed) {
                System.out.println(closed.getMessage());
            }
        }
    }
}

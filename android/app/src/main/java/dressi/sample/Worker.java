package dressi.sample;

import android.content.Context;
import android.content.res.AssetManager;
import android.graphics.Bitmap;
import android.graphics.BitmapFactory;
import dressi.Device;
import dressi.DressiException;
import dressi.Session;
import dressi.Value;
import java.io.ByteArrayOutputStream;
import java.io.File;
import java.io.IOException;
import java.io.InputStream;
import java.nio.ByteBuffer;
import java.nio.FloatBuffer;
import java.util.Arrays;
import java.util.Locale;
import java.util.concurrent.atomic.AtomicBoolean;

/**
 * A thread that runs the phases of one bundle and says how it goes. What it knows is in a checkpoint when {@link #finish} returns.
 *
 * Pictures in the folder of the bundle's name (pear.dressi: pear/0.png, pear/1.png, ...) stand for those of a camera: they are set as
 * targets through the same call.
 */
final class Worker extends Thread {
    interface Listener {
        /** Pictures are null and the loss is NaN where there is nothing new. */
        void onProgress(Worker from, Bitmap target, Bitmap picture, float loss, String status);
    }

    private static final double CHUNK_SECONDS = 0.2; // of steps between two pictures: what a screen needs, and what a finger waits for

    private final Context context;
    private final String bundle;
    private final boolean fresh;
    private final Listener listener;
    private final AtomicBoolean stop = new AtomicBoolean();
    private volatile boolean paused, otherPictures;

    Worker(Context context, String bundle, boolean fresh, boolean paused, Listener listener) {
        super("dressi " + bundle);
        this.context = context.getApplicationContext();
        this.bundle = bundle;
        this.fresh = fresh;
        this.paused = paused;
        this.listener = listener;
    }

    void pause(boolean on) {
        paused = on;
    }

    void otherPictures() {
        otherPictures = true;
    }

    /** Ends the thread within one chunk, its state saved. */
    void finish() {
        stop.set(true);
        boolean interrupted = false;
        while (isAlive()) {
            try {
                join();
            } catch (InterruptedException again) {
                interrupted = true;
            }
        }
        if (interrupted) Thread.currentThread().interrupt();
    }

    @Override
    public void run() {
        try {
            work();
        } catch (DressiException | IOException error) {
            listener.onProgress(this, null, null, Float.NaN, bundle + ": " + error.getMessage());
        }
    }

    private void work() throws IOException {
        say("opening");
        File saved = new File(context.getFilesDir(), bundle + ".checkpoint");
        String cache = new File(context.getCodeCacheDir(), "dressi").getPath();
        try (Device device = new Device(null); Session session = Session.open(direct(bundle), device, null, cache, null)) {
            if (!fresh && saved.exists()) restore(session, saved);
            Value targets = session.find("targets"), color = session.find("render.color");
            ByteBuffer wanted = targets == null ? null : targets.buffer(), shown = color == null ? null : color.buffer();
            if (wanted != null) session.get("targets", wanted);
            Bitmap first = wanted == null ? null : bitmap(targets, wanted);
            listener.onProgress(this, first, null, Float.NaN, about(session, device, "", 0));
            solve(session, device, targets, wanted, color, shown);
            session.checkpoint(saved.getPath());
        }
    }

    private void solve(Session session, Device device, Value targets, ByteBuffer wanted, Value color, ByteBuffer shown) throws IOException {
        for (String phase : session.phases()) {
            long steps = session.steps(phase), left = Math.max(steps - runs(session, phase), 0);
            boolean lossy = session.find(phase + ".loss") != null;
            while (!stop.get() && left > 0) {
                Bitmap fresh = null;
                if (otherPictures && wanted != null) {
                    otherPictures = false;
                    photograph(targets, wanted);
                    session.set("targets", wanted);
                    fresh = bitmap(targets, wanted);
                }
                if (paused) {
                    rest();
                    continue;
                }
                long start = System.nanoTime();
                long ran = session.step(left, phase, CHUNK_SECONDS, stop);
                double each = (System.nanoTime() - start) * 1e-6 / Math.max(ran, 1);
                left -= ran;
                if (shown != null) session.get("render.color", shown);
                float loss = lossy ? session.loss() : Float.NaN;
                String text = String.format(Locale.ROOT, "%s: %d of %d steps, loss %.5g", phase, steps - left, steps, loss);
                listener.onProgress(this, fresh, shown == null ? null : bitmap(color, shown), loss, about(session, device, text, each));
            }
        }
    }

    /** A checkpoint of another bundle of this name is of no use, and gone. */
    private static void restore(Session session, File saved) {
        try {
            session.restore(saved.getPath());
        } catch (DressiException error) {
            if (error.code != DressiException.BUNDLE || !saved.delete()) throw error;
        }
    }

    /** How often a phase has run, from the report's JSON: "runs": {"shape": 12, ...}. */
    private static long runs(Session session, String phase) {
        String report = session.report(), key = "\"" + phase + "\": ";
        int at = report.indexOf(key, report.indexOf("\"runs\": ")) + key.length(), end = at;
        while (end < report.length() && Character.isDigit(report.charAt(end))) end++;
        return end == at ? 0 : Long.parseLong(report.substring(at, end));
    }

    private static String about(Session session, Device device, String progress, double ms) {
        String report = session.report(), key = "\"profile\": \"";
        int at = report.indexOf(key) + key.length();
        return progress + (ms > 0 ? String.format(Locale.ROOT, "\n%.1f ms a step", ms) : "") + "\n" + device.name() + ", " + device.driver()
                + "\nprofile " + report.substring(at, report.indexOf('"', at));
    }

    private void say(String what) {
        listener.onProgress(this, null, null, Float.NaN, bundle + ": " + what);
    }

    private void rest() {
        try {
            Thread.sleep(50);
        } catch (InterruptedException ended) {
            stop.set(true);
        }
    }

    // ---- assets and pictures

    private ByteBuffer direct(String asset) throws IOException {
        try (InputStream in = context.getAssets().open(asset, AssetManager.ACCESS_STREAMING)) {
            ByteArrayOutputStream all = new ByteArrayOutputStream(Math.max(in.available(), 1 << 16));
            byte[] part = new byte[1 << 16];
            for (int n; (n = in.read(part)) > 0; ) all.write(part, 0, n);
            ByteBuffer found = ByteBuffer.allocateDirect(all.size());
            found.put(all.toByteArray());
            found.flip();
            return found;
        }
    }

    /** Fills the targets with pictures from the assets, one a view and as large: what a camera's frames would go through. */
    private void photograph(Value targets, ByteBuffer into) throws IOException {
        String folder = bundle.substring(0, bundle.length() - ".dressi".length());
        String[] names = context.getAssets().list(folder);
        int[] shape = targets.shape(); // views, height, width, channels
        if (names == null || names.length == 0 || shape.length != 4)
            throw new IOException("there are no pictures in the assets' folder " + folder);
        Arrays.sort(names);
        int views = shape[0], height = shape[1], width = shape[2], channels = shape[3];
        int[] pixels = new int[width * height];
        FloatBuffer numbers = into.asFloatBuffer();
        for (int view = 0; view < views; view++) {
            try (InputStream in = context.getAssets().open(folder + "/" + names[view % names.length])) {
                Bitmap found = BitmapFactory.decodeStream(in);
                if (found == null) throw new IOException(names[view % names.length] + " is no picture");
                Bitmap.createScaledBitmap(found, width, height, true).getPixels(pixels, 0, width, 0, 0, width, height);
            }
            for (int pixel : pixels)
                for (int c = 0; c < channels; c++) numbers.put((pixel >>> (c == 3 ? 24 : 16 - 8 * c) & 255) / 255f);
        }
    }

    /** The first view of an atlas, or an image, of 3 or 4 channels between 0 and 1. */
    private static Bitmap bitmap(Value value, ByteBuffer array) {
        int[] shape = value.shape();
        int n = shape.length, channels = value.channels;
        if (n < 3 || channels < 3) return null;
        int height = shape[n - 3], width = shape[n - 2];
        int[] pixels = new int[width * height];
        FloatBuffer numbers = array.asFloatBuffer();
        for (int k = 0; k < pixels.length; k++) {
            int at = k * channels;
            pixels[k] = 0xff000000 | level(numbers, at) << 16 | level(numbers, at + 1) << 8 | level(numbers, at + 2);
        }
        return Bitmap.createBitmap(pixels, width, height, Bitmap.Config.ARGB_8888);
    }

    private static int level(FloatBuffer numbers, int at) {
        return Math.round(Math.min(Math.max(numbers.get(at), 0f), 1f) * 255f);
    }
}
